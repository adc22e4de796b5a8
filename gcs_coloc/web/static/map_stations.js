// The fixed stations on the map, each with its numbers on request.

import { stationIcon } from "./map_icons.js";
import { nodeName } from "./node_names.js";

const L = window.L;
const at = (enu) => [enu[1], enu[0]];

function stationWords({ node, name, sigma_h_m: sigma, source, range_age_s: age, fault }) {
  if (source === "surveyed") return `${nodeName(node)}${name ? ` (${name})` : ""}, surveyed, 1-sigma ${sigma.toFixed(1)} m; add it to the configuration to use it`;
  const ranged = age === null ? "not ranged yet" : age > 5 ? "not ranged now" : "ranged";
  return `${nodeName(node)}${name ? ` (${name})` : ""}, ${source}, 1-sigma ${sigma.toFixed(1)} m, ${ranged}${fault === null ? "" : `; ${fault}`}`;
}

export class StationMarks {
  constructor(map) {
    this.map = map;
    this.marks = new Map();
  }

  places() {
    return [...this.marks.values()].map((mark) => mark.getLatLng());
  }

  show(stations) {
    const seen = new Set();
    for (const station of stations) {
      if (station.enu_m === null) continue;
      const { node } = station;
      seen.add(node);
      const words = stationWords(station);
      let mark = this.marks.get(node);
      if (mark === undefined) {
        const icon = L.divIcon({ className: "mark station-mark", html: stationIcon(station), iconSize: [34, 34] });
        mark = L.marker(at(station.enu_m), { icon, keyboard: false, zIndexOffset: -1000 }).addTo(this.map);
        mark.bindTooltip("");
        mark.getElement().setAttribute("role", "img");
        this.marks.set(node, mark);
      }
      mark.setLatLng(at(station.enu_m));
      mark.setTooltipContent(document.createTextNode(words));
      const element = mark.getElement();
      if (element.getAttribute("aria-label") !== words) element.setAttribute("aria-label", words);
      element.classList.toggle("wrong", station.fault !== null);
    }
    for (const [node, mark] of this.marks) {
      if (seen.has(node)) continue;
      mark.remove();
      this.marks.delete(node);
    }
  }
}
