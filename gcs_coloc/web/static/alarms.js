// Alarms stay until they are acknowledged on this page; alarms with the same text are counted together. The log lists every event.

import { byId, el, prose, setText } from "./dom.js";

const LOG_LINES = 200;

export class Alarms {
  constructor(timeText) {
    this.timeText = timeText;
    this.alarms = new Map();
    this.lines = [];
    this.newest = 0;
    byId("acknowledge-all").addEventListener("click", () => this.acknowledge([...this.alarms.keys()]));
  }

  // A restarted service numbers its events from 1; alarms of the run before stay until they are acknowledged.
  setInstance(instance) {
    if (this.instance === instance) return;
    this.instance = instance;
    this.newest = 0;
    this.done = Number(sessionStorage.getItem(`acknowledged ${instance}`) ?? 0);
  }

  clear() {
    this.acknowledge([...this.alarms.keys()]);
    this.lines = [];
    byId("log").replaceChildren();
  }

  // UTC became known, or changed.
  updateTimes() {
    this.alarms.forEach((alarm) => this.showTime(alarm));
    this.lines.forEach((line) => this.showLine(line));
  }

  add({ events, missed }) {
    if (missed > 0 && this.newest === 0) this.log(`${missed} older events are no longer kept`, "info");
    for (const event of events) {
      if (event.id <= this.newest) continue;
      this.newest = event.id;
      const text = `${event.sysid === null ? "" : `vehicle ${event.sysid}: `}${prose(event.text)}`;
      this.log(text, event.level, event.at_s);
      if (event.alarm && event.id > this.done) this.raise(event, text);
    }
    this.count();
  }

  raise(event, text) {
    const key = `${event.sysid} ${event.level} ${event.text.replace(/[\d.]+/g, "#")}`;
    const alarm = this.alarms.get(key) ?? this.make(key, event);
    alarm.times += 1;
    setText(alarm.text, text);
    alarm.at = event.at_s;
    this.showTime(alarm);
    alarm.button.setAttribute("aria-label", `Acknowledge ${text}`);
  }

  showTime({ when, at, times }) {
    setText(when, this.timeText(at) + (times > 1 ? `, ${times} times` : ""));
  }

  make(key, event) {
    const alarm = { times: 0, text: el("span", { class: "text" }), when: el("span", { class: "when" }) };
    alarm.button = el("button", { type: "button", onclick: () => this.acknowledge([key]) }, "Acknowledge");
    alarm.node = el("li", { class: event.level }, el("span", { class: "sign", "aria-hidden": "true" }, event.level === "error" ? "✕" : "!"),
      alarm.text, alarm.when, alarm.button);
    byId("alarms").prepend(alarm.node);
    this.alarms.set(key, alarm);
    return alarm;
  }

  acknowledge(keys) {
    for (const key of keys) {
      this.alarms.get(key).node.remove();
      this.alarms.delete(key);
    }
    // Only when none is left does the highest number stand for all of them.
    if (this.alarms.size === 0) {
      this.done = this.newest;
      sessionStorage.setItem(`acknowledged ${this.instance}`, String(this.done));
    }
    this.count();
  }

  count() {
    const n = this.alarms.size;
    setText(byId("alarm-count"), n ? `(${n})` : "");
    // A vehicle's details may have scrolled the list out of sight.
    byId("alarm-link").hidden = n === 0;
    setText(byId("alarm-link"), n === 1 ? "1 alarm" : `${n} alarms`);
    byId("no-alarms").hidden = n > 0;
    byId("acknowledge-all").hidden = n < 2;
    document.title = n ? `(${n}) gcs-coloc` : "gcs-coloc";
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
