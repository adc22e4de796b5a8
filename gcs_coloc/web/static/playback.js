// The controls of a replayed flight: play and pause, the position, the speed; and how far the flight is computed.

import { byId, setText } from "./dom.js";

const SPEEDS = [0.5, 1, 2, 5, 10, 50, "max"];
const TAKES_SPACE = "button, select, summary, a, textarea, input:not([type=range]), [role=button]";

const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

export class PlaybackBar {
  constructor() {
    this.state = null;
    this.dragging = false;
    this.queued = null;
    this.sending = false;
    this.reset();
    byId("play").addEventListener("click", () => this.toggle());
    byId("halt").addEventListener("click", () => this.send({ halt: true }));
    const position = byId("position");
    position.addEventListener("input", () => { this.dragging = true; this.showPosition(Number(position.value)); });
    position.addEventListener("change", () => {
      this.dragging = false;
      this.send({ seek_s: this.state.first_s + Number(position.value) });
    });
    byId("speed").replaceChildren(...SPEEDS.map((speed) => new Option(speed === "max" ? "as fast as computed" : `${speed} x`, speed)));
    byId("speed").addEventListener("change", ({ target }) => this.send({ speed: target.value === "max" ? "max" : Number(target.value) }));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  // Another run of the service counts its commands from zero.
  reset() {
    this.commandCount = 0;
  }

  key(event) {
    if (this.state === null || event.ctrlKey || event.altKey || event.metaKey) return;
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

  // Called with false where the address of a replay serves a live fleet now.
  setReplay(isReplay) {
    byId("playback").hidden = !isReplay;
    document.body.classList.toggle("replay", isReplay);
    if (!isReplay) this.state = null;
  }

  show(state) {
    // A state from before our own command would put the controls back for a moment.
    if (this.sending || state.command_count < this.commandCount) return;
    this.state = state;
    setText(byId("play"), state.playing ? "Pause" : "Play");
    byId("halt").disabled = state.goal_s === null;
    const position = byId("position");
    position.max = Math.ceil(state.last_s - state.first_s);
    if (!this.dragging) {
      const at = (state.goal_s ?? state.at_s) - state.first_s;
      position.value = at;
      this.showPosition(at);
    }
    this.showComputed();
    const speed = String(state.speed ?? "max");
    const select = byId("speed");
    if (![...select.options].some((option) => option.value === speed)) select.add(new Option(`${speed} x`, speed));
    if (document.activeElement !== select) select.value = speed;
  }

  showPosition(seconds) {
    const { first_s, last_s, computed_s, goal_s } = this.state;
    const text = `${clock(seconds)} of ${clock(last_s - first_s)}`;
    const isWaiting = goal_s !== null && !this.dragging;
    setText(byId("position-text"), isWaiting ? `computing ${clock(computed_s - first_s)} of ${clock(goal_s - first_s)}` : text);
    byId("position").setAttribute("aria-valuetext", text);
  }

  showComputed() {
    const { first_s, last_s, computed_s } = this.state;
    const isComplete = computed_s >= last_s;
    const bar = byId("computed");
    bar.max = Math.max(last_s - first_s, 1);
    bar.value = computed_s - first_s;
    byId("computed-box").hidden = isComplete;
    setText(byId("computed-text"), isComplete ? "" : `computed ${clock(computed_s - first_s)}`);
  }

  statusText() {
    const { goal_s, playing, at_s, last_s } = this.state;
    return goal_s !== null ? "replay, computing" : playing ? "replay" : at_s >= last_s ? "replay, at the end" : "replay, paused";
  }

  // One request at a time, with the newest of those that come meanwhile: a key that is held down seeks thirty times a second.
  async send(command) {
    this.queued = command.halt ? { ...command, speed: this.queued?.speed } : { ...this.queued, ...command };
    if (this.sending) return;
    this.sending = true;
    let state = null;
    try {
      while (this.queued !== null) {
        const body = JSON.stringify(this.queued);
        this.queued = null;
        const answer = await fetch("/api/playback", { method: "POST", headers: { "Content-Type": "application/json" }, body });
        if (answer.ok) state = await answer.json();
      }
    } catch {
      // The page shows by itself that the connection is lost.
    }
    this.queued = null;
    this.sending = false;
    if (state !== null) {
      this.commandCount = state.command_count;
      this.show(state);
    }
  }
}
