// The list of vehicles and the details of the selected one.

import { age, byId, el, metres, milliseconds, number, setText } from "./dom.js";
import { LIGHT_WORDS, SIGNS } from "./palette.js";

export class FleetList {
  constructor(onSelect) {
    this.onSelect = onSelect;
    this.cards = new Map();
    this.selected = null;
    byId("details").addEventListener("keydown", ({ key }) => {
      if (key === "Escape" && this.cameFrom?.isConnected) this.cameFrom.focus();
    });
  }

  select(sysid) {
    this.selected = sysid;
    for (const [id, card] of this.cards) card.button.setAttribute("aria-pressed", String(id === sysid));
  }

  // By keyboard the details of one among twenty are far from where it was chosen; Escape leads back there.
  enterDetails() {
    this.cameFrom = document.activeElement;
    byId("details-title").focus();
  }

  show(frame, links, lateS) {
    for (const vehicle of frame.vehicles) this.showCard(vehicle, lateS);
    const chosen = frame.vehicles.find((v) => v.view.sysid === this.selected);
    byId("details").hidden = chosen === undefined;
    if (chosen !== undefined) this.showDetails(chosen, links, lateS);
  }

  clear() {
    this.cards.clear();
    byId("fleet").replaceChildren();
  }

  showCard({ view, light, reason }, lateS) {
    const card = this.cards.get(view.sysid) ?? this.makeCard(view.sysid);
    card.node.className = `card ${light}`;
    setText(card.sign, SIGNS[light]);
    const word = `${lateS > 0 ? "was " : ""}${LIGHT_WORDS[light]}`;
    setText(card.word, word);
    setText(card.age, `last heard ${age(view.age_s + lateS)} ago`);
    setText(card.reason, reason);
    // Its words but for what changes all the time, which a screen reader would say again and again.
    const name = `Vehicle ${view.sysid} ${word}, ${reason}`;
    if (card.button.getAttribute("aria-label") !== name) card.button.setAttribute("aria-label", name);
    const ranges = view.ranges_in_use > 0 ? `, HDOP ${number(view.hdop)}, ${view.ranges_in_use} ranges in use` : "";
    setText(card.numbers, view.sigma_h_m === null ? "position unknown" : `1-sigma ${metres(view.sigma_h_m)}${ranges}`);
  }

  makeCard(sysid) {
    const part = (name) => el("span", { class: name, id: `${name}-${sysid}` });
    const card = { sign: part("sign"), word: part("word"), age: part("age"), reason: part("reason"), numbers: part("numbers") };
    card.sign.setAttribute("aria-hidden", "true");
    card.button = el("button", { type: "button", "aria-describedby": `age-${sysid} numbers-${sysid}`, onclick: ({ detail }) => this.onSelect(sysid, detail === 0) },
      card.sign, el("strong", {}, `Vehicle ${sysid}`), card.word, card.age, card.reason, card.numbers);
    card.button.setAttribute("aria-pressed", String(sysid === this.selected));
    card.node = el("li", {}, card.button);
    this.cards.set(sysid, card);
    this.cards = new Map([...this.cards].sort(([a], [b]) => a - b));
    byId("fleet").replaceChildren(...[...this.cards.values()].map((c) => c.node));
    return card;
  }

  showDetails({ view, reason, ellipse }, links, lateS) {
    setText(byId("details-title"), `Vehicle ${view.sysid}`);
    const place = (lat, lon) => (lat === null ? "-" : `${lat.toFixed(6)}, ${lon.toFixed(6)}`);
    const c = view.consistency;
    const link = links.find((one) => one.sysid === view.sysid);
    const facts = {
      state: reason,
      "last heard": `${age(view.age_s + lateS)} ago`,
      autopilot: view.autopilot,
      "its receiver": view.fix_type === null ? "not heard" : `fix type ${view.fix_type}, ${view.satellites ?? "?"} satellites`,
      "our estimate": view.enu_m === null ? `unknown: ${view.no_estimate_reason}` : `${place(view.lat_deg, view.lon_deg)}, ${metres(view.alt_msl_m, 0)} ±${metres(view.sigma_v_m, 0)} above sea level`,
      "its own claim": place(view.reported_lat_deg, view.reported_lon_deg),
      "1-sigma, 95 % bound": `${metres(view.sigma_h_m)}, ${metres(view.bound_95_m)}`,
      "2-sigma ellipse": ellipse === null ? "-" : `${metres(ellipse.semi_major_m)} by ${metres(ellipse.semi_minor_m)}`,
      speed: view.velocity_enu_mps === null ? "-" : `${Math.hypot(view.velocity_enu_mps[0], view.velocity_enu_mps[1]).toFixed(1)} m/s`,
      "HDOP, ranges in use": `${number(view.hdop)}, ${view.ranges_in_use}`,
      "median NIS": c === null ? "-" : `${number(c.nis_median, 2)}, ${c.nis_median > c.band_high ? "above its band" : "band"} ${number(c.band_low, 2)} to ${number(c.band_high, 2)}; ${c.refused} of ${c.ranges} ranges refused`,
      clock: view.clock_method === null ? "-" : `${view.clock_method} ±${milliseconds(view.clock_sigma_s)}`,
      link: link === undefined ? "-" : `${number(link.rate_hz)} frames/s, loss ${number(link.loss_percent)} %`,
      "sent to it": view.aiding,
      "operator's word": `GPS ${view.gps_override}, aid ${view.aiding_override}, GPS_PRIMARY ${view.primary_override}`,
    };
    if (view.gps_primary !== null) facts.GPS_PRIMARY = view.gps_primary;
    if (view.inhibit_reason !== null) facts["cannot be aided"] = view.inhibit_reason;
    const list = byId("facts");
    const names = Object.keys(facts);
    if (list.dataset.names !== names.join()) {
      list.dataset.names = names.join();
      list.replaceChildren(...names.flatMap((name) => [el("dt", {}, name), el("dd")]));
    }
    list.querySelectorAll("dd").forEach((node, i) => setText(node, facts[names[i]]));
  }
}
