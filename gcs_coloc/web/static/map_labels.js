// Where the labels of the vehicles on the map stand.

import { idAndName } from "./node_names.js";
import { SEVERITY } from "./palette.js";

// About a mark, in order of preference: x, y of the label's baseline, and its anchor; px.
const PLACES = {
  estimate: [[15, -7, "start"], [15, 19, "start"], [-15, -7, "end"], [-15, 19, "end"]],
  reported: [[15, 19, "start"], [-15, 19, "end"], [15, -7, "start"], [-15, -7, "end"]],
};
const PX = { estimate: 9, reported: 7.5, height: 15, mark: 11 }; // of a character, by its weight; of a line, half of a mark
const at = (enu) => [enu[1], enu[0]];

export const labelKey = (sysid, kind) => `${sysid} ${kind}`;

// Labels cover neither each other nor a mark; the selected vehicle's and the most serious are placed first. One without room
// is left out.
export function placeLabels(map, vehicles, stations, selected) {
  const taken = [];
  const markAt = (owner, enu) => {
    const { x, y } = map.latLngToContainerPoint(at(enu));
    taken.push([owner, x - PX.mark, y - PX.mark, x + PX.mark, y + PX.mark]);
    return [x, y];
  };
  for (const { enu_m: enu } of stations) if (enu !== null) markAt(null, enu);
  const rank = ({ snapshot, light }) => (snapshot.sysid === selected ? -1 : SEVERITY[light]);
  const wanted = [];
  for (const { snapshot } of [...vehicles].sort((a, b) => rank(a) - rank(b) || a.snapshot.sysid - b.snapshot.sysid)) {
    const { sysid, gps_state: state, enu_m: estimated, reported_enu_m: reported } = snapshot;
    if (estimated !== null) wanted.push({ sysid, kind: "estimate", point: markAt(sysid, estimated), length: idAndName(snapshot).length + 3 });
    if (state !== "healthy" && reported !== null) wanted.push({ sysid, kind: "reported", point: markAt(sysid, reported), length: String(sysid).length + 9 });
  }
  const labels = new Map();
  for (const { sysid, kind, point: [x, y], length } of wanted) {
    const width = length * PX[kind];
    const free = PLACES[kind].find(([dx, dy, anchor]) => {
      const left = x + dx - (anchor === "end" ? width : 0);
      const box = [left, y + dy - PX.height + 2, left + width, y + dy + 2];
      const isFree = taken.every(([owner, l, t, r, b]) => owner === sysid || box[0] > r || box[2] < l || box[1] > b || box[3] < t);
      if (isFree) taken.push([null, ...box]);
      return isFree;
    });
    if (free !== undefined) labels.set(labelKey(sysid, kind), free);
  }
  return labels;
}
