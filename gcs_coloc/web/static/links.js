// Link statistics, ground tools, and what was refused by reason.

import { byId, el, number } from "./dom.js";

export function showCounts({ links, outs, refused, estimator_counts }, vehicles) {
  const delays = new Map(vehicles.map((v) => [v.snapshot.sysid, v.snapshot.delay_s]));
  byId("link-rows").replaceChildren(...links.map((link) => {
    const delay = delays.get(link.sysid) ?? null;
    const cells = [number(link.rate_hz), link.loss_percent === null ? "-" : `${number(link.loss_percent)} %`,
      delay === null ? "-" : `${(delay * 1e3).toFixed(0)} ms`, String(link.lost), String(link.duplicates)];
    return el("tr", {}, el("th", { scope: "row" }, String(link.sysid)), ...cells.map((text) => el("td", {}, text)));
  }));
  showOuts(outs);
  showTable("refused", refused);
  showTable("estimator-counts", estimator_counts);
}

function showOuts(outs) {
  byId("outs").hidden = outs.length === 0;
  byId("out-rows").replaceChildren(...outs.map((out) => {
    const cells = [out.tools, number(out.rate_hz), out.frames_accepted, out.dropped, out.refused].map(String);
    return el("tr", {}, el("th", { scope: "row" }, out.name), ...cells.map((text) => el("td", {}, text)));
  }));
}

function showTable(id, counts) {
  const rows = Object.entries(counts).sort(([, a], [, b]) => b - a);
  byId(id).replaceChildren(...(rows.length ? rows : [["nothing", 0]]).flatMap(([what, times]) => [el("dt", {}, what), el("dd", {}, String(times))]));
}
