// The controls of a replayed flight: play and pause, the place, the speed.

import { byId, setText } from "./dom.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 50, "max"];
const TAKES_SPACE = "button, select, summary, a, textarea, input:not([type=range]), [role=button]";

const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

export class PlaybackBar {
  constructor() {
    this.held = false;
    this.waiting = null;
    this.sending = false;
    this.begin();
    byId("play").addEventListener("click", () => this.toggle());
    byId("halt").addEventListener("click", () => this.send({ halt: true }));
    const place = byId("place");
    place.addEventListener("input", () => { this.held = true; this.showPlace(Number(place.value)); });
    place.addEventListener("change", () => {
      this.held = false;
      this.send({ seek_s: this.state.first_s + Number(place.value) });
    });
    byId("speed").replaceChildren(...SPEEDS.map((speed) => new Option(speed === "max" ? "as fast as it goes" : `${speed} x`, speed)));
    byId("speed").addEventListener("change", ({ target }) => this.send({ speed: target.value === "max" ? "max" : Number(target.value) }));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  // Another run of the service counts its commands anew.
  begin() {
    this.obeyed = 0;
  }

  key(event) {
    if (byId("playback").hidden || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key === " " && !event.target.closest(TAKES_SPACE)) {
      event.preventDefault();
      if (!event.repeat) this.toggle();
    }
    if (event.key === "Escape" && this.state.goal_s !== null) this.send({ halt: true });
  }

  toggle() {
    this.state.playing = !this.state.playing;
    setText(byId("play"), this.state.playing ? "Pause" : "Play");
    this.send({ playing: this.state.playing });
  }

  show(state) {
    byId("playback").hidden = state === null;
    document.body.classList.toggle("replay", state !== null);
    // What was said before a command of ours was obeyed would put the controls back for a moment.
    if (state === null || this.sending || state.obeyed < this.obeyed) return;
    this.state = state;
    setText(byId("play"), state.playing ? "Pause" : "Play");
    byId("halt").disabled = state.goal_s === null;
    const place = byId("place");
    place.max = Math.ceil(state.last_s - state.first_s);
    // Not while it is being dragged.
    if (!this.held) {
      const at = (state.goal_s ?? state.at_s) - state.first_s;
      place.value = at;
      this.showPlace(at);
    }
    const speed = String(state.speed ?? "max");
    const select = byId("speed");
    if (![...select.options].some((option) => option.value === speed)) select.add(new Option(`${speed} x`, speed));
    if (document.activeElement !== select) select.value = speed;
  }

  showPlace(seconds) {
    const { first_s, last_s, at_s, goal_s } = this.state;
    const text = `${clock(seconds)} of ${clock(last_s - first_s)}`;
    setText(byId("place-text"), goal_s === null || this.held ? text : `computing ${clock(at_s - first_s)} of ${clock(goal_s - first_s)}`);
    byId("place").setAttribute("aria-valuetext", text);
  }

  words() {
    return this.state.goal_s !== null ? "replay, computing" : this.state.playing ? "replay" : this.state.at_s >= this.state.last_s ? "replay, at the end" : "replay, paused";
  }

  // One after the other, and of those that come meanwhile the newest: a key that is held down asks for thirty places a second.
  async send(command) {
    this.waiting = command.halt ? { ...command, speed: this.waiting?.speed } : { ...this.waiting, ...command };
    if (this.sending) return;
    this.sending = true;
    let state = null;
    try {
      while (this.waiting !== null) {
        const body = JSON.stringify(this.waiting);
        this.waiting = null;
        const answer = await fetch("/api/playback", { method: "POST", headers: { "Content-Type": "application/json" }, body });
        if (answer.ok) state = await answer.json();
      }
    } catch {
      // The page says by itself that the connection is lost.
    }
    this.waiting = null;
    this.sending = false;
    if (state !== null) {
      this.obeyed = state.obeyed;
      this.show(state);
    }
  }
}
