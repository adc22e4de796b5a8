// Plots on one time axis: 1-sigma, HDOP, NIS against its band, ranges in use, and the residuals. A sample a second, ten minutes.

import { byId, el, svg } from "./dom.js";
import { css, seriesColour, seriesDash } from "./palette.js";
import { ResidualPlot } from "./residual_plot.js";

const uPlot = window.uPlot;
const SAMPLES = 600;
const HEIGHT = 150;
const READ_AT_ONCE = 6; // values beside the cursor; more do not fit into one line
const SPIKE = 3; // times what 95 % of the values stay below; a value beyond that is cut off
const TIME_STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600]; // no finer ones: times are told to the second
const VALUE_STEP_PX = 20; // so that the residuals have a value beside zero, whatever their size
const KINDS = [
  { key: "sigma_h_m", title: "1-sigma, m" },
  { key: "hdop", title: "HDOP" },
  { key: "nis_median", title: "median NIS with its 95 % band" },
  { key: "ranges_in_use", title: "ranges in use" },
];

export class Plots {
  constructor() {
    this.selected = null;
    this.hidden = new Set();
    this.residuals = new ResidualPlot((...parts) => this.makePlot(...parts), (t) => this.clock(t));
    this.reset(null);
    this.resizing = new ResizeObserver(() => [...(this.plots ?? []), this.residuals.plot].forEach((p) => p?.setSize(size(p.root.parentNode))));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  reset(offset) {
    this.offset = offset;
    this.residuals.reset(offset);
    this.rows = new Map();
    this.sysids = [];
  }

  setOffset(offset) {
    this.offset = offset;
    this.residuals.offset = offset;
    this.build();
  }

  restore(history) {
    for (const one of history) {
      one.at_s.forEach((t, i) => {
        this.put(t, one.sysid, Object.fromEntries([...KINDS.map((k) => k.key), "band_low", "band_high"].map((key) => [key, one[key][i]])));
      });
    }
    this.rows = new Map([...this.rows].sort(([a], [b]) => a - b));
    this.build();
  }

  add(frame) {
    for (const { snapshot } of frame.vehicles) {
      const c = snapshot.consistency;
      this.put(frame.at_s, snapshot.sysid, {
        sigma_h_m: snapshot.sigma_h_m, hdop: snapshot.hdop, ranges_in_use: snapshot.ranges_in_use,
        nis_median: c?.nis_median ?? null, band_low: c?.band_low ?? null, band_high: c?.band_high ?? null,
      });
    }
    while (this.rows.size > SAMPLES) this.rows.delete(this.rows.keys().next().value);
    if (this.built !== this.sysids.length) this.build();
    else this.redraw();
    this.residuals.add(frame);
  }

  put(t, sysid, values) {
    if (!this.rows.has(t)) this.rows.set(t, new Map());
    this.rows.get(t).set(sysid, values);
    if (!this.sysids.includes(sysid)) this.sysids = [...this.sysids, sysid].sort((a, b) => a - b);
  }

  select(sysid) {
    this.selected = sysid;
    this.residuals.select(sysid);
    this.build();
  }

  column(sysid, key) {
    return [...this.rows.values()].map((row) => row.get(sysid)?.[key] ?? null);
  }

  data(kind) {
    const times = [...this.rows.keys()].map((t) => t + (this.offset ?? 0));
    const columns = this.sysids.map((id) => this.column(id, kind.key));
    if (kind.key !== "nis_median") return [times, ...columns];
    // The band of the selected vehicle, or of the first that has one.
    const owner = this.selected ?? this.sysids.find((id) => this.column(id, "band_low").some((x) => x !== null)) ?? this.sysids[0];
    return [times, ...columns, this.column(owner, "band_high"), this.column(owner, "band_low")];
  }

  build() {
    this.plots?.forEach((p) => p.destroy());
    this.resizing.disconnect();
    this.built = this.sysids.length;
    this.nameSeries();
    this.plots = KINDS.map((kind) => {
      const series = this.sysids.map((id, i) => ({
        label: `vehicle ${id}`, stroke: seriesColour(i), dash: seriesDash(i), width: id === this.selected ? 3 : 1.5, spanGaps: false, points: { show: false }, show: !this.hidden.has(id),
      }));
      const n = series.length;
      const isNis = kind.key === "nis_median";
      if (isNis) for (const label of ["band, high", "band, low"]) series.push({ label, stroke: css("--faint"), width: 1, points: { show: false } });
      return this.makePlot(kind, series, this.data(kind), { y: { range: (u) => [0, top(u) * 1.1] } }, (u) => this.reading(u),
        isNis && n > 0 ? [{ series: [n + 1, n + 2], fill: css("--band") }] : []);
    });
    this.residuals.build();
  }

  // One plot in a figure of its own, in place of the one of the same key.
  makePlot({ key, title }, series, data, scales, read, bands = []) {
    const axis = { stroke: css("--text"), grid: { stroke: css("--grid"), width: 1 }, ticks: { stroke: css("--grid") } };
    const reading = el("figcaption", {});
    const holder = el("figure", { "aria-label": `Plot of ${title} over time`, "data-key": key });
    const old = byId("plots").querySelector(`[data-key="${key}"]`);
    if (old) old.replaceWith(holder);
    else byId("series").before(holder);
    const plot = new uPlot({
      ...size(holder), padding: [null, 30, null, null], title, series: [{}, ...series], axes: [{ ...axis, space: 80, incrs: TIME_STEPS_S, values: (_, times) => times.map((t) => this.clock(t)) }, { ...axis, size: 46, space: VALUE_STEP_PX }],
      bands, cursor: { sync: { key: "time" } }, scales: { x: { time: this.offset !== null }, ...scales },
      legend: { show: false }, hooks: { setCursor: [(u) => { reading.textContent = read(u); }] },
    }, data, holder);
    holder.append(reading);
    this.resizing.observe(holder);
    return plot;
  }

  // One legend for all plots: a legend in each would be as long as the fleet.
  nameSeries() {
    byId("series").replaceChildren(...this.sysids.map((id, i) => {
      const button = el("button", { type: "button", class: "link", "aria-pressed": String(!this.hidden.has(id)) },
        svg("svg", { viewBox: "0 0 36 14", "aria-hidden": "true" },
          svg("path", { d: "M0 7H36", stroke: seriesColour(i), "stroke-width": 3, "stroke-dasharray": seriesDash(i).join(" ") || null })),
        `vehicle ${id}`);
      button.addEventListener("click", () => this.toggle(id, i, button));
      return el("li", { class: id === this.selected ? "chosen" : null }, button);
    }));
  }

  toggle(id, i, button) {
    if (!this.hidden.delete(id)) this.hidden.add(id);
    const show = !this.hidden.has(id);
    button.setAttribute("aria-pressed", String(show));
    this.plots.forEach((p) => p.setSeries(i + 1, { show }));
  }

  // The values under the cursor, the selected vehicle's first; empty beside the plot.
  reading(u) {
    const at = u.cursor.idx;
    if (at === null || at === undefined || u.cursor.left < 0) return "";
    const values = this.sysids.map((id, i) => ({ id, value: u.data[i + 1]?.[at] }))
      .filter(({ id, value }) => value !== null && value !== undefined && !this.hidden.has(id))
      .sort((a, b) => (b.id === this.selected) - (a.id === this.selected));
    const shown = values.slice(0, READ_AT_ONCE).map(({ id, value }) => `${id}: ${Number(value.toFixed(2))}`);
    return [this.clock(u.data[0][at]), ...shown, ...(values.length > READ_AT_ONCE ? ["…"] : [])].join("   ");
  }

  clock(t) {
    return this.offset === null ? `${t} s` : new Date(t * 1000).toLocaleTimeString([], { hour12: false });
  }

  redraw() {
    KINDS.forEach((kind, i) => this.plots[i].setData(this.data(kind)));
  }
}

// A spike does not set the scale: what is above is cut. Hidden lines and the band do not count.
const top = (u) => {
  const values = u.series.flatMap((one, i) => (i > 0 && one.show && one.label.startsWith("vehicle") ? u.data[i] : []))
    .filter((value) => value !== null && value !== undefined).sort((a, b) => a - b);
  if (values.length === 0) return 1;
  const usual = values[Math.floor(0.95 * (values.length - 1))];
  return Math.max(1, Math.min(values.at(-1), SPIKE * usual));
};

const size = (holder) => ({ width: Math.max(holder.clientWidth, 200), height: HEIGHT });
