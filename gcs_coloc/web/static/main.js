// One WebSocket in, everything else out. What is shown is never newer than what was heard, and says so when it is old.

import { age, byId, setText } from "./dom.js";
import { Alarms } from "./alarms.js";
import { Commands } from "./commands.js";
import { FleetList } from "./fleet.js";
import { showCounts } from "./links.js";
import { FleetMap } from "./map.js";
import { PlaybackBar } from "./playback.js";
import { Plots } from "./plots.js";

const OLD_AFTER_S = 1.5;
const SAMPLE_EVERY_S = 1;
const SAME_TIME_S = 0.5;

const now = () => performance.now() / 1000;
let offset = null;
let frame = null;
let counts = null;
let instance = null;
let frameAt = 0;
let sampledAt = -Infinity;
let retryS = 0.5;

const timeText = (at) => (offset === null ? `${at.toFixed(1)} s` : new Date((at + offset) * 1000).toLocaleTimeString([], { hour12: false }));
const alarms = new Alarms(timeText);
const plots = new Plots();
const playback = new PlaybackBar();
const fleet = new FleetList(select);
const map = new FleetMap(select);
const commands = new Commands();

byId("follow").addEventListener("click", () => map.followSelected());

function select(sysid, byKeyboard) {
  for (const part of [fleet, map, plots, commands]) part.select(sysid);
  if (frame !== null) draw();
  if (byKeyboard) fleet.enterDetails();
  byId("details").scrollIntoView({ block: "nearest" });
}

function draw() {
  // While pictures arrive the ages in them are the truth; once they stop, the ages grow with the time since.
  const old = now() - frameAt;
  fleet.show(frame, counts?.links ?? [], old < OLD_AFTER_S ? 0 : old);
}

// A service that has just begun may not know the time yet, and a computer without a clock of its own is told it in flight.
function tellTime(told) {
  if (told === null || (offset !== null && Math.abs(told - offset) < SAME_TIME_S)) return;
  offset = told;
  alarms.tellTimes();
  plots.tellTime(offset);
}

function hello(message) {
  offset = message.utc_minus_service_s;
  sampledAt = -Infinity;
  if (instance !== message.instance) {
    instance = message.instance;
    map.clear();
    fleet.clear();
    // What was an alarm further on in a replayed flight has not happened yet.
    if (message.replay) alarms.clear();
  }
  alarms.begin(message.instance);
  map.showTiles(message.tiles);
  commands.allow(message.commands);
  plots.reset(offset);
  plots.restore(message.history);
  for (const one of message.history) map.restoreTrail(one.sysid, one.east_m, one.north_m);
}

// In a long list those that need a look may be out of sight: they are named at the top.
function summary({ vehicles, estimator }) {
  const named = (light, words) => {
    const sysids = vehicles.filter((v) => v.light === light).map((v) => v.view.sysid);
    return `${sysids.length} ${words}${sysids.length ? ` (${sysids.join(", ")})` : ""}`;
  };
  const heard = `${vehicles.length} vehicle${vehicles.length === 1 ? "" : "s"}`;
  return `${heard}, ${named("bad", "in alarm")}, ${named("caution", "with caution")}; estimator ${estimator}`;
}

function picture(message) {
  frame = message;
  frameAt = now();
  tellTime(frame.utc_minus_service_s);
  draw();
  playback.show(frame.playback);
  map.show(frame);
  if (frame.at_s - sampledAt >= SAMPLE_EVERY_S) {
    sampledAt = frame.at_s;
    map.extendTrails(frame.vehicles);
    plots.add(frame);
  }
  setText(byId("summary"), summary(frame));
}

function counted(message) {
  counts = message;
  showCounts(counts, frame?.vehicles ?? []);
}

const takers = { hello, fleet: picture, counts: counted, events: (message) => alarms.take(message) };

let socket = null;
let shownAt = 0;

// A page that nobody looks at needs no pictures; the history tells it afterwards what went by.
function tellVisibility() {
  if (socket?.readyState === WebSocket.OPEN) socket.send(document.hidden ? "hidden" : "visible");
}

document.addEventListener("visibilitychange", () => {
  if (!document.hidden) shownAt = now();
  tellVisibility();
});

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.addEventListener("open", () => {
    retryS = 0.5;
    playback.begin();
    if (document.hidden) tellVisibility();
  });
  socket.addEventListener("message", ({ data }) => {
    const message = JSON.parse(data);
    takers[message.kind](message);
  });
  socket.addEventListener("close", () => {
    setTimeout(connect, retryS * 1000);
    retryS = Math.min(retryS * 2, 5);
  });
}

// A browser that cannot reach the service writes that to its console; asking /healthz first would not spare it.
setInterval(() => {
  if (document.hidden) return;
  const old = now() - frameAt;
  const live = frame !== null && old < OLD_AFTER_S;
  document.body.classList.toggle("old", frame !== null && !live);
  setText(byId("connection"), live ? (frame.playback === null ? "live" : playback.words()) : frame === null ? "connecting" : `${now() - shownAt < OLD_AFTER_S ? "catching up" : "NO CONNECTION"}: what you see is ${age(old)} old`);
  if (frame !== null && !live) draw();
}, 250);

connect();
