// The controls of a replayed flight: play and pause, the place, the speed.

import { byId, setText } from "./dom.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 50, "max"];

const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

export class PlaybackBar {
  constructor() {
    this.held = false;
    byId("play").addEventListener("click", () => this.send({ playing: !this.state?.playing }));
    const place = byId("place");
    place.addEventListener("input", () => { this.held = true; this.showPlace(Number(place.value)); });
    place.addEventListener("change", () => {
      this.held = false;
      this.send({ seek_s: this.state.first_s + Number(place.value) });
    });
    byId("speed").replaceChildren(...SPEEDS.map((speed) => new Option(speed === "max" ? "as fast as it goes" : `${speed} x`, speed)));
    byId("speed").addEventListener("change", ({ target }) => this.send({ speed: target.value === "max" ? "max" : Number(target.value) }));
  }

  show(state) {
    byId("playback").hidden = state === null;
    document.body.classList.toggle("replay", state !== null);
    if (state === null) return;
    this.state = state;
    setText(byId("play"), state.playing ? "Pause" : "Play");
    const place = byId("place");
    place.max = Math.ceil(state.last_s - state.first_s);
    // Not while it is being dragged.
    if (!this.held) {
      place.value = (state.goal_s ?? state.at_s) - state.first_s;
      this.showPlace(state.at_s - state.first_s);
    }
    const speed = String(state.speed ?? "max");
    const select = byId("speed");
    if (![...select.options].some((option) => option.value === speed)) select.add(new Option(`${speed} x`, speed));
    if (document.activeElement !== select) select.value = speed;
  }

  showPlace(seconds) {
    const { first_s, last_s, goal_s } = this.state;
    const text = `${clock(seconds)}${goal_s === null || this.held ? "" : ` to ${clock(goal_s - first_s)}`} of ${clock(last_s - first_s)}`;
    setText(byId("place-text"), text);
    byId("place").setAttribute("aria-valuetext", text);
  }

  words() {
    return this.state.goal_s !== null ? "replay, on its way" : this.state.playing ? "replay" : this.state.at_s >= this.state.last_s ? "replay, at the end" : "replay, paused";
  }

  async send(command) {
    try {
      await fetch("/api/playback", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command) });
    } catch {
      // The page says by itself that the connection is lost.
    }
  }
}
