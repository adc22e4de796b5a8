// The residual of each range of one vehicle over time: the selected vehicle's, or else that of the first that has ranges.

import { nodeName } from "./node_names.js";
import { seriesColour, seriesDash } from "./palette.js";

const SAMPLES = 600;
const SPIKE = 3; // times what 95 % of the residuals stay below; what is beyond is cut off
const name = ({ from_sysid: from, to_sysid: to }) => `${nodeName(from)}\u2192${nodeName(to)}`;
const isOf = (sysid) => ({ from_sysid: from, to_sysid: to }) => from === sysid || to === sysid;

export class ResidualPlot {
  // `makePlot` makes a plot in a figure of its own, `clock` words a time.
  constructor(makePlot, clock) {
    this.makePlot = makePlot;
    this.clock = clock;
    this.selected = null;
    this.reset(null);
  }

  reset(offset) {
    this.offset = offset;
    this.rows = [];
    this.ranges = [];
  }

  add({ at_s: at, ranges }) {
    this.rows.push([at, new Map(ranges.map((range) => [name(range), range.innovation_m]))]);
    this.rows = this.rows.slice(-SAMPLES);
    const known = new Set(this.ranges.map(name));
    this.ranges.push(...ranges.filter((range) => !known.has(name(range))));
    if (this.names.join() === this.pairs().join()) this.plot.setData(this.data());
    else this.build();
  }

  select(sysid) {
    this.selected = sysid;
  }

  vehicle() {
    return this.selected ?? this.ranges[0]?.from_sysid ?? null;
  }

  pairs() {
    return this.ranges.filter(isOf(this.vehicle())).map(name).sort();
  }

  data() {
    return [this.rows.map(([t]) => t + (this.offset ?? 0)), ...this.names.map((one) => this.rows.map(([, row]) => row.get(one) ?? null))];
  }

  build() {
    this.plot?.destroy();
    this.names = this.pairs();
    const vehicle = this.vehicle();
    const series = this.names.map((label, i) => ({ label, stroke: seriesColour(i), dash: seriesDash(i), width: 1.5, points: { show: false } }));
    const title = vehicle === null ? "residuals of the ranges, m" : `residuals of the ranges of vehicle ${vehicle}, m`;
    this.plot = this.makePlot({ key: "residuals", title }, series, this.data(), {
      y: { range: (u) => [-most(u) * 1.1, most(u) * 1.1] },
    }, (u) => this.reading(u));
  }

  reading(u) {
    const at = u.cursor.idx;
    if (at === null || at === undefined || u.cursor.left < 0) return "";
    const shown = this.names.map((one, i) => [one, u.data[i + 1]?.[at]]).filter(([, value]) => value !== null && value !== undefined);
    return [this.clock(u.data[0][at]), ...shown.map(([one, value]) => `${one}: ${Number(value.toFixed(2))}`)].join("   ");
  }
}

const most = (u) => {
  const sizes = u.data.slice(1).flat().filter((value) => value !== null && value !== undefined).map(Math.abs).sort((a, b) => a - b);
  if (sizes.length === 0) return 1;
  return Math.max(1, Math.min(sizes.at(-1), SPIKE * sizes[Math.floor(0.95 * (sizes.length - 1))]));
};
