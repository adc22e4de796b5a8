// The service's alarms, the same on every page; sound and notification on request. The log lists every event.

import { byId, el, prose, setText } from "./dom.js";

const LOG_LINES = 200;
const SOUND_HZ = 880;
const SOUND_S = 0.4;
const WAITS = new Set(["active", "over"]); // to be acknowledged
// A notice has no duration: whether its cause lasts is not known, so that it is never called over.
const shownState = ({ kind, state }) => (kind === "notice" ? "notice" : state);
const STATE_WORDS = { active: "", acknowledged: "acknowledged", over: "over", notice: "" };

const about = (sysid) => (sysid === null ? "" : `vehicle ${sysid}: `);

export class Alarms {
  constructor(timeText) {
    this.timeText = timeText;
    this.nodes = new Map();
    this.waiting = [];
    this.lines = [];
    this.newest = 0;
    this.isFirst = true;
    this.readOnly = false;
    byId("acknowledge-all").addEventListener("click", () => this.waiting.forEach(acknowledge));
    this.sound = new Switch("sound", () => this.play());
    this.notification = new Switch("notify", async () => {
      const answer = await Notification.requestPermission();
      if (answer !== "granted") this.notification.set(false);
    });
    if (!("Notification" in window)) byId("notify").hidden = true;
  }

  // A restarted service numbers its events and alarms from 1.
  setInstance(instance, readOnly) {
    this.readOnly = readOnly;
    if (this.instance === instance) return;
    this.instance = instance;
    this.newest = 0;
    this.isFirst = true;
    this.show([]);
  }

  clear() {
    this.lines = [];
    byId("log").replaceChildren();
  }

  // UTC became known, or changed.
  updateTimes() {
    for (const { node, alarm } of this.nodes.values()) this.fill(node, alarm);
    this.lines.forEach((line) => this.showLine(line));
  }

  add({ events, missed }) {
    if (missed > 0 && this.newest === 0) this.log(`${missed} older events are no longer kept`, "info");
    let raised = null;
    for (const event of events) {
      if (event.id <= this.newest) continue;
      this.newest = event.id;
      const text = about(event.sysid) + prose(event.text);
      this.log(text, event.level, event.at_s);
      if (event.alarm) raised = text;
    }
    // What a page finds when it opens is no news.
    if (raised !== null && !this.isFirst) this.announce(raised);
    this.isFirst = false;
  }

  announce(text) {
    setText(byId("announcer"), text);
    if (this.sound.on) this.play();
    if (this.notification.on) new Notification("gcs-coloc", { body: text, tag: "gcs-coloc" });
  }

  play() {
    this.audio ??= new AudioContext();
    this.audio.resume();
    const [oscillator, volume, at] = [this.audio.createOscillator(), this.audio.createGain(), this.audio.currentTime];
    oscillator.frequency.value = SOUND_HZ;
    volume.gain.setValueAtTime(0.3, at);
    volume.gain.exponentialRampToValueAtTime(0.001, at + SOUND_S);
    oscillator.connect(volume).connect(this.audio.destination);
    oscillator.start(at);
    oscillator.stop(at + SOUND_S);
  }

  show(alarms) {
    const ids = new Set(alarms.map(({ id }) => id));
    for (const [id, { node }] of this.nodes) {
      if (ids.has(id)) continue;
      node.remove();
      this.nodes.delete(id);
    }
    for (const alarm of alarms) {
      const node = this.nodes.get(alarm.id)?.node ?? this.make(alarm);
      this.nodes.set(alarm.id, { node, alarm });
      this.fill(node, alarm);
    }
    this.arrange();
    this.waiting = alarms.filter(({ state }) => WAITS.has(state)).map(({ id }) => id);
    const n = this.waiting.length;
    setText(byId("alarm-count"), n ? `(${n})` : "");
    // A vehicle's details may have scrolled the list out of sight.
    byId("alarm-link").hidden = n === 0 || this.readOnly;
    setText(byId("alarm-link"), n === 1 ? "1 alarm to acknowledge" : `${n} alarms to acknowledge`);
    byId("no-alarms").hidden = alarms.length > 0;
    byId("acknowledge-all").hidden = n < 2 || this.readOnly;
    document.title = n && !this.readOnly ? `(${n}) gcs-coloc` : "gcs-coloc";
  }

  make({ id, kind, sysid }) {
    const button = el("button", { type: "button", onclick: () => acknowledge(id) }, "Acknowledge");
    return el("li", { "data-kind": kind, "data-sysid": sysid }, el("span", { class: "sign", "aria-hidden": "true" }), el("span", { class: "text" }), el("span", { class: "when" }), button);
  }

  fill(node, alarm) {
    const { sysid, level, text, action, raised_at_s: raised, over_at_s: over, times } = alarm;
    const state = shownState(alarm);
    node.className = `${level} ${state}`;
    const [sign, words, when, button] = node.children;
    setText(sign, state === "over" ? "–" : level === "error" ? "✕" : "!");
    setText(words, `${state === "over" ? "over: " : ""}${about(sysid)}${prose(text)}${/[.!?]$/.test(text) ? "" : "."} ${action}`);
    const lasts = over === null ? `since ${this.timeText(raised)}` : raised === over ? this.timeText(over) : `${this.timeText(raised)} to ${this.timeText(over)}`;
    setText(when, [lasts, times > 1 ? `${times} times` : "", STATE_WORDS[state]].filter(Boolean).join(", "));
    button.hidden = this.readOnly || !WAITS.has(alarm.state);
    const label = `Acknowledge ${about(sysid)}${prose(text.replace(/[\d.]+ (s|m)\b/g, ""))}`;
    if (button.getAttribute("aria-label") !== label) button.setAttribute("aria-label", label);
  }

  // What holds and nobody has acknowledged stands first, the most serious before the newest.
  arrange() {
    const rank = ({ state, level }) => ({ active: 0, over: 2, acknowledged: 4 })[state] + (level === "error" ? 0 : 1);
    const order = [...this.nodes.values()].sort((a, b) => rank(a.alarm) - rank(b.alarm) || b.alarm.id - a.alarm.id);
    const list = byId("alarms");
    order.forEach(({ node }, i) => {
      if (list.children[i] === node) return;
      const focused = node.contains(document.activeElement) ? document.activeElement : null;
      list.insertBefore(node, list.children[i] ?? null);
      focused?.focus();
    });
  }

  log(text, level, at = null) {
    const line = { text, at, node: el("li", { class: level }) };
    this.showLine(line);
    this.lines.push(line);
    byId("log").prepend(line.node);
    while (this.lines.length > LOG_LINES) this.lines.shift().node.remove();
  }

  showLine({ node, text, at }) {
    setText(node, at === null ? text : `${this.timeText(at)} ${text}`);
  }
}

// A button that stays pressed, also in the next session.
class Switch {
  constructor(id, turnedOn) {
    this.button = byId(id);
    this.button.addEventListener("click", () => {
      this.set(!this.on);
      if (this.on) turnedOn();
    });
    this.set(localStorage.getItem(id) === "on");
  }

  set(on) {
    this.on = on;
    this.button.setAttribute("aria-pressed", String(on));
    localStorage.setItem(this.button.id, on ? "on" : "off");
  }
}

async function acknowledge(id) {
  try {
    await fetch(`/api/alarms/${id}/acknowledge`, { method: "POST" });
  } catch {
    // The page shows by itself that the connection is lost; the alarm stays.
  }
}
