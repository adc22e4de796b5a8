// The ranges between nodes, one line for each direction side by side; what the estimator made of each on request.

import { byId, el } from "./dom.js";
import { nodeName } from "./node_names.js";

const L = window.L;
const APART_PX = 3; // of each line from the straight one, where there are both directions
const VALUE_AT = 0.4; // along the line, from the node that measured

const signed = (metres) => `${metres < 0 ? "\u2212" : "+"}${Math.abs(metres).toFixed(1)} m`;

function rangeClass(range) {
  if (range.refused !== null) return "range range-refused";
  const size = Math.abs(range.innovation_m) / range.sigma_m;
  return size < 1 ? "range range-1" : size < 3 ? "range range-2" : "range range-3";
}

export class RangeLines {
  constructor(map) {
    this.map = map;
    this.lines = new Map();
    this.values = L.layerGroup();
    this.shown = [[], new Map()];
    map.on("zoomend", () => this.show(...this.shown));
    byId("range-values").addEventListener("click", () => this.toggleValues());
  }

  toggleValues() {
    const on = !this.map.hasLayer(this.values);
    byId("range-values").setAttribute("aria-pressed", String(on));
    if (on) this.values.addTo(this.map);
    else this.values.remove();
    this.show(...this.shown);
  }

  // `places`: east, north, up in metres of each node.
  show(ranges, places) {
    this.shown = [ranges, places];
    const drawn = ranges.filter((range) => places.has(range.from_sysid) && places.has(range.to_sysid));
    const pairs = new Set(drawn.map((range) => `${range.from_sysid} ${range.to_sysid}`));
    for (const range of drawn) {
      const both = pairs.has(`${range.to_sysid} ${range.from_sysid}`);
      this.draw(range, this.ends(places.get(range.from_sysid), places.get(range.to_sysid), both ? APART_PX : 0));
    }
    for (const [key, { line, value }] of this.lines) {
      if (pairs.has(key)) continue;
      line.remove();
      this.values.removeLayer(value);
      this.lines.delete(key);
    }
  }

  // Each direction keeps to its own right, as on a road.
  ends([ae, an], [be, bn], apartPx) {
    const length = Math.hypot(be - ae, bn - an) || 1;
    const apart = apartPx / 2 ** this.map.getZoom() / length;
    const [e, n] = [(bn - an) * apart, (ae - be) * apart];
    return [[an + n, ae + e], [bn + n, be + e]];
  }

  draw(range, ends) {
    const key = `${range.from_sysid} ${range.to_sysid}`;
    const className = rangeClass(range);
    let one = this.lines.get(key);
    if (one === undefined || one.line.options.className !== className) {
      one?.line.remove();
      const line = L.polyline(ends, { className, weight: 2 }).addTo(this.map);
      line.bindTooltip("", { sticky: true });
      line.getElement().tabIndex = -1; // Leaflet listens for its focus, which makes it a stop of the Tab key
      one = { line, value: one?.value ?? this.makeValue() };
      this.lines.set(key, one);
    }
    one.line.setLatLngs(ends);
    const [from, to] = [range.from_sysid, range.to_sysid].map(nodeName);
    const use = range.refused === null ? "used" : `refused: ${range.refused}`;
    one.line.setTooltipContent(document.createTextNode(
      `${from} to ${to}: residual ${range.innovation_m.toFixed(1)} m of sigma ${range.sigma_m.toFixed(1)} m, ${range.age_s.toFixed(1)} s old, ${use}`,
    ));
    const [[an, ae], [bn, be]] = ends;
    one.value.setLatLng([an + VALUE_AT * (bn - an), ae + VALUE_AT * (be - ae)]);
    one.value.text.textContent = `${from}\u2192${to} ${signed(range.innovation_m)}${range.refused === null ? "" : " refused"}`;
  }

  makeValue() {
    const text = el("span", {});
    const value = L.marker([0, 0], { interactive: false, keyboard: false, icon: L.divIcon({ className: "range-value", html: text, iconSize: [0, 0] }) });
    value.text = text;
    this.values.addLayer(value);
    return value;
  }
}
