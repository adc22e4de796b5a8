// Where the labels of the vehicles on the map stand.

import { idAndName } from "./node_names.js";
import { SEVERITY } from "./palette.js";

// About a vehicle's mark, in order of preference: x, y of the label's baseline, and its anchor; px.
const LABEL_PLACES = [[15, -7, "start"], [15, 19, "start"], [-15, -7, "end"], [-15, 19, "end"]];
const LABEL_PX = { character: 9, height: 15, mark: 11 };
const at = (enu) => [enu[1], enu[0]];

// Labels cover neither each other nor a mark; the selected vehicle's and the most serious are placed first. One without room
// is left out.
export function placeLabels(map, vehicles, stations, selected) {
  const located = vehicles.filter(({ snapshot }) => snapshot.enu_m !== null);
  const points = new Map(located.map(({ snapshot }) => [snapshot.sysid, map.latLngToContainerPoint(at(snapshot.enu_m))]));
  const { character, height, mark } = LABEL_PX;
  const taken = [...points].map(([sysid, { x, y }]) => [sysid, x - mark, y - mark, x + mark, y + mark]);
  for (const { enu_m: enu } of stations) {
    if (enu === null) continue;
    const { x, y } = map.latLngToContainerPoint(at(enu));
    taken.push([null, x - mark, y - mark, x + mark, y + mark]);
  }
  // The marks of reported positions have their own labels, always at the same side.
  for (const { snapshot: { sysid, gps_state, reported_enu_m: enu } } of vehicles) {
    if (gps_state === "healthy" || enu === null) continue;
    const { x, y } = map.latLngToContainerPoint(at(enu));
    taken.push([null, x + 13, y + 19 - height, x + 13 + (String(sysid).length + 9) * 7.5, y + 19]);
  }
  const labels = new Map();
  const rank = ({ snapshot, light }) => (snapshot.sysid === selected ? -1 : SEVERITY[light]);
  for (const { snapshot } of located.sort((a, b) => rank(a) - rank(b) || a.snapshot.sysid - b.snapshot.sysid)) {
    const { sysid } = snapshot;
    const { x, y } = points.get(sysid);
    const width = (idAndName(snapshot).length + 3) * character;
    const free = LABEL_PLACES.find(([dx, dy, anchor]) => {
      const left = x + dx - (anchor === "end" ? width : 0);
      const box = [sysid, left, y + dy - height + 2, left + width, y + dy + 2];
      const isFree = taken.every(([other, l, t, r, b]) => other === sysid || box[1] > r || box[3] < l || box[2] > b || box[4] < t);
      if (isFree) taken.push([null, ...box.slice(1)]);
      return isFree;
    });
    if (free !== undefined) labels.set(sysid, free);
  }
  return labels;
}
