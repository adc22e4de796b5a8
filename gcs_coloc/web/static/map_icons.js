// The marks on the map: a vehicle estimated, reported and true, and a station.

import { svg } from "./dom.js";
import { idAndName } from "./node_names.js";
import { READINESS_SIGNS, SIGNS } from "./palette.js";

function heading(snapshot) {
  if (snapshot.yaw_rad !== null) return (snapshot.yaw_rad * 180) / Math.PI;
  const v = snapshot.velocity_enu_mps;
  return v !== null && Math.hypot(v[0], v[1]) > 2 ? (Math.atan2(v[0], v[1]) * 180) / Math.PI : null;
}

// The text of a mark at its place beside it; nothing where it has none.
function labelled(place, text) {
  return place === undefined ? [] : [svg("text", { class: "name", x: place[0], y: place[1], "text-anchor": place[2] }, text)];
}

export function estimateIcon(snapshot, light, stale, label) {
  const turn = heading(snapshot);
  const body = turn === null
    ? svg("circle", { cx: 0, cy: 0, r: 9 })
    : svg("path", { d: "M0 -14L9 11L0 6L-9 11Z", transform: `rotate(${turn.toFixed(0)})` });
  return svg("svg", { class: `vehicle ${light}${stale ? " stale" : ""}`, viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    body, ...labelled(label, `${idAndName(snapshot)} ${SIGNS[light]}${snapshot.readiness === null ? "" : READINESS_SIGNS[snapshot.readiness.state]}`));
}

export function stationIcon({ station_id: id }) {
  return svg("svg", { class: "station", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("path", { d: "M0 -9L8 7H-8Z" }), svg("text", { class: "name", x: 0, y: 19, "text-anchor": "middle" }, `S${id}`));
}

export function truthIcon(snapshot) {
  return svg("svg", { class: "vehicle truth", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("path", { d: "M0 -13V-4M0 4V13M-13 0H-4M4 0H13" }), svg("circle", { cx: 0, cy: 0, r: 8 }),
    ...(snapshot.gps_state === "healthy" ? [] : [svg("text", { class: "name", x: -11, y: 17, "text-anchor": "end" }, `${snapshot.sysid} true`)]));
}

export function reportedIcon(snapshot, label) {
  return svg("svg", { class: "vehicle reported", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("rect", { x: -8, y: -8, width: 16, height: 16 }), svg("path", { d: "M-8 -8L8 8M8 -8L-8 8" }),
    ...labelled(label, `${snapshot.sysid} reported`));
}
