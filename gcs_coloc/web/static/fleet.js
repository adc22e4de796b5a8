// The list of vehicles and the details of the selected one.

import { age, byId, el, metres, milliseconds, number, setText } from "./dom.js";
import { nodeName, vehicleName } from "./node_names.js";
import { LIGHT_WORDS, READINESS_WORDS, SEVERITY, SIGNS } from "./palette.js";

const NOBODY = "no vehicle heard yet";
const COMPACT_FROM = 9; // vehicles; so many cards are higher than a screen

// What the vehicle says of itself, as far as it does.
function flight({ mode, armed, battery_percent: battery, alt_msl_m: height }) {
  return [mode, armed === null ? null : armed ? "armed" : "disarmed", battery === null ? null : `${battery} %`, height === null ? null : metres(height, 0)]
    .filter((part) => part !== null).join(", ");
}

// As in "2, 3 and station 4": vehicles first.
const listed = (nodes) => [...nodes].sort((a, b) => (a < 0) - (b < 0) || Math.abs(a) - Math.abs(b)).map(nodeName).join(", ").replace(/, (?=[^,]*$)/, " and ");

// The levels that an error does not exceed, and on what that rests.
function protection({ sysid, hpl_m: hpl, vpl_m: vpl, untested }) {
  if (hpl === null) return "-";
  const others = untested.filter((node) => node !== sysid);
  const device = others.length === untested.length ? "" : "; assumes that its ranging device is right: no range tests it";
  const assumed = others.length === 0 ? "" : `; assumes that ${listed(others)} ${others.length === 1 ? "is where it says: no range tests it" : "are where they say: no range tests them"}`;
  return `${metres(hpl)}, height ${metres(vpl)}${device}${assumed}`;
}

// How good its position is; the protection level first, for that decides on a fix.
function quality({ sigma_h_m: sigma, hpl_m: hpl, hdop, ranges_in_use: ranges }) {
  if (sigma === null) return "position unknown";
  return [hpl === null ? null : `protection level ${metres(hpl)}`, `1-sigma ${metres(sigma)}`, ...(ranges > 0 ? [`HDOP ${number(hdop)}`, `${ranges} ranges in use`] : [])]
    .filter((part) => part !== null).join(", ");
}

// Whether it would be located if its GPS failed now, and why not; empty while its GPS is not healthy. A list of many shows the second part alone.
function withoutGps({ readiness: found }) {
  return found === null ? ["", "", ""] : ["without GPS ", READINESS_WORDS[found.state], found.text === "" ? "" : `: ${found.text}`];
}

// The same with what it would have then.
function withoutGpsInFull(snapshot) {
  const found = snapshot.readiness;
  if (found === null) return "-";
  const levels = found.hpl_m === null ? "no position" : `protection level ${metres(found.hpl_m)}, 95 % bound ${metres(found.bound_95_m)}${found.is_told ? "" : " (uncertain)"}, HDOP ${number(found.hdop)}`;
  return `${withoutGps(snapshot).slice(1).join("")}; peers ranged: ${found.peers}; half a minute after a loss: ${levels}`;
}

// An override, and who gave it.
const given = (value, by) => (by === null ? value : `${value} by ${by}`);

export class FleetList {
  constructor(onSelect) {
    this.onSelect = onSelect;
    this.cards = new Map();
    this.gone = new Set();
    this.selected = null;
    this.without = "connecting";
    byId("filter").addEventListener("input", () => this.filter());
    byId("details").addEventListener("keydown", ({ key }) => {
      if (key === "Escape" && this.cameFrom?.isConnected) this.cameFrom.focus();
    });
  }

  select(sysid) {
    this.selected = sysid;
    for (const [id, card] of this.cards) card.button.setAttribute("aria-pressed", String(id === sysid));
  }

  // The details are far down the tab order from the vehicle that was chosen by keyboard; Escape goes back to it.
  enterDetails() {
    this.cameFrom = document.activeElement;
    byId("details-title").focus();
  }

  show(frame, links, lateS) {
    const sysids = new Set(frame.vehicles.map((v) => v.snapshot.sysid));
    for (const [sysid, card] of this.cards) {
      if (sysids.has(sysid)) continue;
      card.node.remove();
      this.cards.delete(sysid);
    }
    for (const vehicle of frame.vehicles) this.showCard(vehicle, lateS);
    byId("fleet").classList.toggle("compact", sysids.size >= COMPACT_FROM);
    this.arrange();
    this.without = NOBODY;
    this.filter();
    this.showGone(sysids);
    const chosen = frame.vehicles.find((v) => v.snapshot.sysid === this.selected);
    byId("details").hidden = chosen === undefined;
    if (chosen !== undefined) this.showDetails(chosen, links, lateS);
  }

  // Another run of the service has heard nobody yet; whom the run before had heard is kept in mind.
  restart() {
    for (const sysid of this.cards.keys()) this.gone.add(sysid);
    this.clear(NOBODY);
  }

  // `without` is what stands in place of the vehicles until a picture shows some.
  clear(without) {
    this.without = without;
    this.cards.clear();
    byId("fleet").replaceChildren();
    byId("details").hidden = true;
    this.filter();
  }

  // The most serious first. What stands right is not moved: a focus would be lost, and a list that moves cannot be read.
  arrange() {
    const list = byId("fleet");
    const order = [...this.cards].sort(([a, one], [b, other]) => SEVERITY[one.light] - SEVERITY[other.light] || a - b);
    order.forEach(([, { node }], i) => {
      if (list.children[i] === node) return;
      const focused = node.contains(document.activeElement) ? document.activeElement : null;
      list.insertBefore(node, list.children[i] ?? null);
      focused?.focus({ preventScroll: true });
    });
  }

  // A number is a vehicle's; other words are looked for in all that its card says.
  filter() {
    const wanted = byId("filter").value.trim().toLowerCase();
    let matches = 0;
    for (const [sysid, { node }] of this.cards) {
      node.hidden = wanted !== "" && !(/^\d+$/.test(wanted) ? String(sysid) === wanted : node.textContent.toLowerCase().includes(wanted));
      matches += !node.hidden;
    }
    byId("no-vehicles").hidden = matches > 0;
    setText(byId("no-vehicles"), this.cards.size > 0 ? "no vehicle matches the filter" : this.without);
  }

  // Leads from a vehicle's number in the header to its card.
  focusCard(sysid) {
    byId("filter").value = "";
    this.filter();
    this.cards.get(sysid)?.button.focus();
  }

  showGone(sysids) {
    for (const sysid of sysids) this.gone.delete(sysid);
    byId("gone").hidden = this.gone.size === 0;
    setText(byId("gone"), `Gone: heard before the service restarted, and not since: ${[...this.gone].sort((a, b) => a - b).join(", ")}`);
  }

  showCard({ snapshot, light, reason }, lateS) {
    const card = this.cards.get(snapshot.sysid) ?? this.makeCard(snapshot);
    card.node.className = `card ${light}`;
    card.light = light;
    setText(card.sign, SIGNS[light]);
    const word = `${lateS > 0 ? "was " : ""}${LIGHT_WORDS[light]}`;
    setText(card.word, word);
    setText(card.age, `last heard ${age(snapshot.age_s + lateS)} ago`);
    setText(card.flight, flight(snapshot));
    setText(card.reason, reason);
    // Without the numbers that change all the time, which a screen reader would repeat.
    const name = `${vehicleName(snapshot)} ${word}, ${reason}`;
    if (card.button.getAttribute("aria-label") !== name) card.button.setAttribute("aria-label", name);
    setText(card.numbers, quality(snapshot));
    withoutGps(snapshot).forEach((text, i) => setText(card.readiness.children[i], text));
    card.readiness.dataset.state = snapshot.readiness?.state ?? "";
  }

  makeCard(snapshot) {
    const { sysid } = snapshot;
    const part = (name) => el("span", { class: name, id: `${name}-${sysid}` });
    const card = { sign: part("sign"), word: part("word"), age: part("age"), flight: part("flight"), reason: part("reason"), numbers: part("numbers"), readiness: part("readiness") };
    card.sign.setAttribute("aria-hidden", "true");
    card.readiness.append(el("span"), el("span"), el("span"));
    card.button = el("button", { type: "button", "aria-describedby": `age-${sysid} flight-${sysid} numbers-${sysid} readiness-${sysid}`, onclick: ({ detail }) => this.onSelect(sysid, detail === 0) },
      card.sign, el("strong", {}, vehicleName(snapshot)), card.word, card.age, card.flight, card.reason, card.numbers, card.readiness);
    card.button.setAttribute("aria-pressed", String(sysid === this.selected));
    card.node = el("li", {}, card.button);
    this.cards.set(sysid, card);
    return card;
  }

  showDetails({ snapshot, reason, ellipse }, links, lateS) {
    setText(byId("details-title"), vehicleName(snapshot));
    const place = (lat, lon) => (lat === null ? "-" : `${lat.toFixed(6)}, ${lon.toFixed(6)}`);
    const c = snapshot.consistency;
    const link = links.find((one) => one.sysid === snapshot.sysid);
    const facts = {
      "estimated position": snapshot.enu_m === null ? `unknown: ${snapshot.no_estimate_reason}` : `${place(snapshot.lat_deg, snapshot.lon_deg)}, ${metres(snapshot.alt_msl_m, 0)} ±${metres(snapshot.sigma_v_m, 0)} above sea level`,
      "protection level": protection(snapshot),
      "1-sigma, 95 % bound": `${metres(snapshot.sigma_h_m)}, ${metres(snapshot.bound_95_m)}`,
      "HDOP, ranges in use": `${number(snapshot.hdop)}, ${snapshot.ranges_in_use}`,
      state: reason,
      "without GPS": withoutGpsInFull(snapshot),
      "last heard": `${age(snapshot.age_s + lateS)} ago`,
      autopilot: snapshot.autopilot,
      flight: flight(snapshot) || "-",
      "GPS receiver": snapshot.fix_type === null ? "not heard" : `fix type ${snapshot.fix_type}, ${snapshot.satellites ?? "?"} satellites`,
      "reported position": place(snapshot.reported_lat_deg, snapshot.reported_lon_deg),
      "2-sigma ellipse": ellipse === null ? "-" : `${metres(ellipse.semi_major_m)} by ${metres(ellipse.semi_minor_m)}`,
      speed: snapshot.velocity_enu_mps === null ? "-" : `${Math.hypot(snapshot.velocity_enu_mps[0], snapshot.velocity_enu_mps[1]).toFixed(1)} m/s`,
      "median NIS": c === null ? "-" : `${number(c.nis_median, 2)}, ${c.nis_median > c.band_high ? "above its band" : "band"} ${number(c.band_low, 2)} to ${number(c.band_high, 2)}; ${c.refused} of ${c.ranges} ranges refused`,
      clock: snapshot.clock_method === null ? "-" : `${snapshot.clock_method} ±${milliseconds(snapshot.clock_sigma_s)}`,
      link: link === undefined ? "-" : `${number(link.rate_hz)} frames/s, loss ${number(link.loss_percent)} %`,
      aiding: snapshot.aiding,
      "operator override": `GPS ${given(snapshot.gps_override, snapshot.gps_override_by)}, aiding ${given(snapshot.aiding_override, snapshot.aiding_override_by)}, GPS_PRIMARY ${given(snapshot.primary_override, snapshot.primary_override_by)}`,
    };
    if (snapshot.gps_primary !== null) facts.GPS_PRIMARY = snapshot.gps_primary;
    if (snapshot.inhibit_reason !== null) facts["aiding inhibited"] = snapshot.inhibit_reason;
    const list = byId("facts");
    const names = Object.keys(facts);
    if (list.dataset.names !== names.join()) {
      list.dataset.names = names.join();
      list.replaceChildren(...names.flatMap((name) => [el("dt", {}, name), el("dd")]));
    }
    list.querySelectorAll("dd").forEach((node, i) => setText(node, facts[names[i]]));
  }
}
