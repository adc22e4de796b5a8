// Receives the messages of one WebSocket and hands them to the parts of the page. An old picture is marked as old.

import { age, byId, el, setText } from "./dom.js";
import { Alarms } from "./alarms.js";
import { Commands } from "./commands.js";
import { Confirmation, shareToken } from "./confirm.js";
import { FleetList } from "./fleet.js";
import { showCounts } from "./links.js";
import { openLive } from "./live_connection.js";
import { FleetMap } from "./map.js";
import { PlaybackBar } from "./playback.js";
import { Plots } from "./plots.js";
import { StandbyPanel } from "./standby.js";

const OLD_AFTER_S = 1.5;
const SAMPLE_EVERY_S = 1;
const SAME_TIME_S = 0.5;
const SELECTED = "selected vehicle";

const now = () => performance.now() / 1000;
let offset = null;
let frame = null;
let counts = null;
let instance = null;
let frameAt = 0;
let sampledAt = -Infinity;

const timeText = (at) => (offset === null ? `${at.toFixed(1)} s` : new Date((at + offset) * 1000).toLocaleTimeString([], { hour12: false }));
const alarms = new Alarms(timeText);
const plots = new Plots();
const playback = new PlaybackBar();
const fleet = new FleetList(select);
const map = new FleetMap(select);
const confirmation = new Confirmation();
const commands = new Commands(confirmation);
const standby = new StandbyPanel(confirmation);
shareToken();

byId("follow").addEventListener("click", () => map.followSelected());

function select(sysid, byKeyboard) {
  sessionStorage.setItem(SELECTED, sysid);
  for (const part of [fleet, map, plots, commands]) part.select(sysid);
  if (frame !== null) draw();
  if (byKeyboard) fleet.enterDetails();
  byId("details").scrollIntoView({ block: "nearest" });
}

function draw() {
  // While pictures arrive, the ages in them hold; once they stop, the ages grow with the time since.
  const old = now() - frameAt;
  const older = old < OLD_AFTER_S ? 0 : old;
  fleet.show(frame, counts?.links ?? [], older);
  standby.show(frame.standby, timeText, older);
  commands.show(frame.vehicles);
}

// A service that has just started may not know UTC yet; a computer without a battery-backed clock learns it in flight.
function updateOffset(utcMinusService) {
  if (utcMinusService === null || (offset !== null && Math.abs(utcMinusService - offset) < SAME_TIME_S)) return;
  offset = utcMinusService;
  alarms.updateTimes();
  plots.setOffset(offset);
}

function hello(message) {
  offset = message.utc_minus_service_s;
  sampledAt = -Infinity;
  if (instance !== message.instance) {
    instance = message.instance;
    // Nothing of another run, or of a later position of a replayed flight, holds any more.
    frame = counts = null;
    map.clear();
    if (message.replay) {
      fleet.clear("the first picture is being computed");
      alarms.clear();
    } else fleet.restart();
  }
  alarms.setInstance(message.instance, message.replay);
  map.showTiles(message.tiles);
  commands.allow(message.commands);
  standby.allow(message.commands);
  playback.setReplay(message.replay);
  plots.reset(offset);
  plots.restore(message.history);
  for (const one of message.history) map.restoreTrail(one.sysid, one.east_m, one.north_m);
}

// In a long list the vehicles in alarm may be scrolled out of sight: the summary at the top names them and leads there.
function showSummary({ vehicles, estimator }) {
  const of = (light) => vehicles.filter((v) => v.light === light).map((v) => v.snapshot.sysid);
  const [bad, caution] = [of("bad"), of("caution")];
  const shown = JSON.stringify([vehicles.length, bad, caution, estimator]);
  const node = byId("summary");
  if (node.dataset.shown === shown) return;
  node.dataset.shown = shown;
  const link = (sysid) => el("button", { type: "button", class: "link", "aria-label": `Vehicle ${sysid}: to its card`, onclick: () => {
    select(sysid, false);
    fleet.focusCard(sysid);
  } }, String(sysid));
  const named = (sysids, words) => [`, ${sysids.length} ${words}`, ...(sysids.length ? [" (", ...sysids.flatMap((id, i) => [i ? ", " : "", link(id)]), ")"] : [])];
  node.replaceChildren(`${vehicles.length} vehicle${vehicles.length === 1 ? "" : "s"}`, ...named(bad, "in alarm"), ...named(caution, "with caution"), `; estimator ${estimator}`);
}

function picture(message) {
  frame = message;
  frameAt = now();
  updateOffset(frame.utc_minus_service_s);
  draw();
  alarms.show(frame.alarms);
  map.show(frame);
  if (frame.at_s - sampledAt >= SAMPLE_EVERY_S) {
    sampledAt = frame.at_s;
    map.extendTrails(frame.vehicles);
    plots.add(frame);
  }
  showSummary(frame);
}

function counted(message) {
  counts = message;
  showCounts(counts, frame?.vehicles ?? []);
}

const handlers = {
  hello,
  fleet: picture,
  counts: counted,
  events: (message) => alarms.add(message),
  playback: (message) => playback.show(message),
};

let shownAt = 0;

setInterval(() => {
  if (document.hidden) return;
  const old = now() - frameAt;
  const live = frame !== null && old < OLD_AFTER_S;
  document.body.classList.toggle("old", frame !== null && !live);
  setText(byId("connection"), live ? (playback.state === null ? "live" : playback.statusText()) : frame === null ? "connecting" : `${now() - shownAt < OLD_AFTER_S ? "catching up" : "NO CONNECTION"}: what you see is ${age(old)} old`);
  if (frame !== null && !live) draw();
}, 250);

const selected = Number(sessionStorage.getItem(SELECTED));
if (selected > 0) for (const part of [fleet, map, plots, commands]) part.select(selected);
// The history in hello brings a page that comes into sight up to date.
openLive(handlers, "fleet", { opened: () => playback.reset(), inSight: () => { shownAt = now(); } });
