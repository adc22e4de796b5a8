// All fleets on one page, the most serious first. What is not known is shown as unknown, what is past as past.

import { age, byId, el, metres, prose, setText } from "./dom.js";
import { openLive } from "./live_connection.js";
import { idAndName } from "./node_names.js";
import { LIGHT_WORDS, SEVERITY, SIGNS } from "./palette.js";

const OLD_AFTER_S = 2;
const PRESENCE_WORDS = { stale: "not heard", lost: "connection lost", ended: "ended", kept: "no sign of life", untold: "not told" };
const OPEN = new Set(["stale", "lost", "untold"]); // besides those that are live and not good
const WAITS = new Set(["active", "over"]); // to be acknowledged
const COLUMNS = ["vehicle", "state", "reason", "latitude, longitude", "height", "95 %", "HPL", "aided", "last heard"];
const LABELS = [null, null, null, "at", "height", "95 %", "HPL", "aided", "heard"];

const now = () => performance.now() / 1000;
const nodes = new Map();
let frame = null;
let frameAt = 0;
let shownAt = 0;

const key = ({ source, host }) => `${source} ${host}`;
const isLive = ({ presence }) => presence === "live";
const plural = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;
const clock = (unixS) => new Date(unixS * 1000).toLocaleString([], { hour12: false });
const sorted = (vehicles) => [...vehicles].sort((a, b) => SEVERITY[a.light] - SEVERITY[b.light] || a.sysid - b.sysid);
const aided = (v) => (v.aiding_has_fix ? "fix" : v.gps_state === "healthy" ? "-" : "no fix");

// A page that is served on every address of its computer is reached under the name that this one was reached by.
function reachable(page) {
  const url = new URL(page);
  if (url.hostname === "0.0.0.0" || url.hostname === "[::]") url.hostname = location.hostname;
  return url.href;
}

// How the vehicles stand, as in "2 alarm, 8 good".
function counts(vehicles) {
  const of = (light) => vehicles.filter((v) => v.light === light).length;
  return Object.keys(SEVERITY).map((light) => [light, of(light)]).filter(([, n]) => n > 0).map(([light, n]) => `${n} ${LIGHT_WORDS[light]}`).join(", ");
}

function word(fleet) {
  const vehicles = fleet.overview?.vehicles ?? [];
  if (!isLive(fleet)) return PRESENCE_WORDS[fleet.presence];
  return vehicles.length === 0 ? "no vehicle heard yet" : counts(vehicles);
}

function heard(fleet, lateS) {
  if (fleet.age_s !== null) return `last heard ${age(fleet.age_s + lateS)} ago`;
  return fleet.written_unix_s === null ? "written at an unknown time" : `written ${clock(fleet.written_unix_s)} by its own clock`;
}

// What a fleet that is not heard was like; of one that tells nothing, which vehicles it has.
function told(fleet) {
  const vehicles = fleet.overview?.vehicles ?? [];
  const was = isLive(fleet) || vehicles.length === 0 ? "" : `; was: ${counts(vehicles)}`;
  const silent = fleet.overview === null && fleet.sysids.length ? `; its vehicles, state unknown: ${fleet.sysids.join(", ")}` : "";
  return isLive(fleet) ? "" : `${fleet.text}${was}${silent}`;
}

function make(fleet) {
  const part = (tag, name) => el(tag, { class: name });
  const node = { sign: el("span", { class: "word", "aria-hidden": "true" }), name: el("h3"), host: part("span", "host"), word: part("span", "word"), heard: part("span", "heard"), page: el("a", { class: "own-page" }, "its own page"), told: part("p", "told"), problem: part("p", "told problem"), alarms: part("ul", "alarms"), rows: el("tbody"), touched: false };
  const table = el("table", {}, el("thead", {}, el("tr", {}, ...COLUMNS.map((name) => el("th", { scope: "col", class: name === "state" || name === "reason" ? "left" : null }, name)))), node.rows);
  table.setAttribute("aria-label", `Vehicles of fleet ${fleet.name}${fleet.host ? ` on ${fleet.host}` : ""}`);
  node.table = el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": table.getAttribute("aria-label") }, table);
  const summary = el("summary", { onclick: () => { node.touched = true; } }, node.sign, node.name, node.host, node.word, node.heard, node.told, node.problem);
  node.details = el("details", {}, summary, el("div", { class: "inside" }, node.alarms, node.table));
  node.page.setAttribute("aria-label", `Page of fleet ${fleet.name}`);
  node.root = el("section", { class: "fleet" }, node.page, node.details);
  nodes.set(key(fleet), node);
  return node;
}

function show(fleet, lateS) {
  const node = nodes.get(key(fleet)) ?? make(fleet);
  const vehicles = sorted(fleet.overview?.vehicles ?? []);
  node.root.className = `fleet ${fleet.light}${isLive(fleet) ? "" : " past"}`;
  node.root.setAttribute("aria-label", `Fleet ${fleet.name}${fleet.host ? ` on ${fleet.host}` : ""}`);
  setText(node.sign, SIGNS[fleet.light]);
  setText(node.name, fleet.name);
  node.name.title = fleet.source;
  setText(node.host, fleet.host ? `on ${fleet.host}` : "host unknown");
  setText(node.word, word(fleet));
  setText(node.heard, heard(fleet, lateS));
  setText(node.told, told(fleet));
  setText(node.problem, fleet.problem ?? "");
  node.page.hidden = fleet.page === null;
  if (fleet.page !== null) node.page.href = reachable(fleet.page);
  if (!node.touched) node.details.open = isLive(fleet) ? fleet.light !== "good" : OPEN.has(fleet.presence);
  node.table.hidden = vehicles.length === 0;
  showAlarms(node, fleet);
  showRows(node, fleet, vehicles, lateS);
}

// Each vehicle's row says its most serious condition already; the alarms are those that it does not say.
function showAlarms(node, fleet) {
  const said = new Set((fleet.overview?.vehicles ?? []).map((v) => `${v.sysid} ${v.reason}`));
  const alarms = fleet.overview?.alarms ?? [];
  const was = isLive(fleet) ? "" : "was: ";
  // A notice has no duration, and its cause may last: those of the whole fleet stand here, those of vehicles are counted.
  const isShown = ({ kind, sysid, state, text }) => (kind === "notice" ? sysid === null : state !== "over" && !said.has(`${sysid} ${text}`));
  const lines = alarms.filter(isShown)
    .map(({ sysid, state, level, text }) => [level, `${was}${sysid === null ? "" : `vehicle ${sysid}: `}${prose(text)}${state === "acknowledged" ? " (acknowledged)" : ""}`]);
  const over = alarms.filter(({ kind, state }) => kind !== "notice" && state === "over").length;
  if (over) lines.push(["", `${was}${plural(over, "alarm")} over and not acknowledged`]);
  const notices = alarms.filter(({ kind, sysid }) => kind === "notice" && sysid !== null).length;
  if (notices) lines.push(["", `${was}${plural(notices, "notice")} of vehicles not acknowledged`]);
  const content = JSON.stringify(lines);
  if (node.alarms.dataset.content === content) return;
  node.alarms.dataset.content = content;
  node.alarms.hidden = lines.length === 0;
  node.alarms.replaceChildren(...lines.map(([level, text]) => el("li", { class: level }, text)));
}

function showRows(node, fleet, vehicles, lateS) {
  while (node.rows.children.length > vehicles.length) node.rows.lastChild.remove();
  while (node.rows.children.length < vehicles.length) {
    const cells = COLUMNS.slice(1).map((name, i) => el("td", { class: name === "state" ? "light left" : name === "reason" ? "reason" : null, "data-label": LABELS[i + 1] }));
    node.rows.append(el("tr", {}, el("th", { scope: "row" }), ...cells));
  }
  vehicles.forEach((v, i) => {
    const row = node.rows.children[i];
    row.className = isLive(fleet) ? v.light : "unknown";
    const place = v.lat_deg === null || v.lon_deg === null ? "unknown" : `${v.lat_deg.toFixed(5)}, ${v.lon_deg.toFixed(5)}`;
    const state = isLive(fleet) ? `${SIGNS[v.light]} ${LIGHT_WORDS[v.light]}` : `? was ${LIGHT_WORDS[v.light]}`;
    const last = fleet.age_s === null ? "unknown" : `${age(v.age_s + fleet.age_s + lateS)} ago`;
    [idAndName(v), state, prose(v.reason), place, metres(v.alt_msl_m, 0), metres(v.bound_95_m), metres(v.hpl_m), aided(v), last].forEach((text, cell) => setText(row.children[cell], text));
  });
}

// What stands right is not moved: a focus would be lost, and a list that moves cannot be read.
function arrange(fleets) {
  const list = byId("fleets");
  fleets.forEach((fleet, i) => {
    const { root } = nodes.get(key(fleet));
    if (list.children[i] === root) return;
    const focused = root.contains(document.activeElement) ? document.activeElement : null;
    list.insertBefore(root, list.children[i] ?? null);
    focused?.focus({ preventScroll: true });
  });
}

// Words are looked for in all that is shown of a fleet.
function filter() {
  const wanted = byId("filter").value.trim().toLowerCase();
  let found = 0;
  for (const { root } of nodes.values()) {
    root.hidden = wanted !== "" && !root.textContent.toLowerCase().includes(wanted);
    found += !root.hidden;
  }
  byId("none").hidden = nodes.size > 0;
  byId("none-matches").hidden = found > 0 || nodes.size === 0;
}

function summary(fleets) {
  const live = fleets.filter(isLive);
  const named = (some, words) => (some.length ? `, ${some.length} ${words} (${some.slice(0, 5).map(({ name }) => name).join(", ")}${some.length > 5 ? ", ..." : ""})` : "");
  const vehicles = live.reduce((n, { overview }) => n + overview.vehicles.length, 0);
  const silent = fleets.filter(({ presence }) => presence === "stale" || presence === "lost");
  return `${plural(live.length, "live fleet")} with ${plural(vehicles, "vehicle")}${named(live.filter(({ light }) => light === "bad"), "in alarm")}${named(live.filter(({ light }) => light === "caution"), "with caution")}${named(silent, "not heard")}`;
}

function draw() {
  const old = now() - frameAt;
  const lateS = old < OLD_AFTER_S ? 0 : old;
  const { fleets, origin, problem, refused } = frame;
  const present = new Set(fleets.map(key));
  for (const [id, { root }] of nodes) {
    if (present.has(id)) continue;
    root.remove();
    nodes.delete(id);
  }
  fleets.forEach((fleet) => show(fleet, lateS));
  arrange(fleets);
  filter();
  setText(byId("origin"), origin);
  setText(byId("problem"), problem ?? "");
  setText(byId("summary"), fleets.length ? summary(fleets) : "no fleet heard yet");
  const reasons = Object.entries(refused).map(([reason, n]) => `${reason} ${n}`).join(", ");
  setText(byId("refused"), reasons && `refused: ${reasons}`);
  const alarms = fleets.filter(isLive).flatMap(({ overview }) => overview.alarms).filter(({ state }) => WAITS.has(state)).length;
  document.title = alarms ? `(${alarms}) gcs-coloc: all fleets` : "gcs-coloc: all fleets";
}

byId("filter").addEventListener("input", filter);
setInterval(() => {
  if (document.hidden) return;
  const old = now() - frameAt;
  const live = frame !== null && old < OLD_AFTER_S;
  document.body.classList.toggle("old", frame !== null && !live);
  setText(byId("connection"), live ? "live" : frame === null ? "connecting" : `${now() - shownAt < OLD_AFTER_S ? "catching up" : "NO CONNECTION"}: what you see is ${age(old)} old`);
  if (frame !== null && !live) draw();
}, 250);

const fleets = (message) => {
  frame = message;
  frameAt = now();
  draw();
};
openLive({ hello: () => {}, fleets }, "fleets", { inSight: () => { shownAt = now(); } });
