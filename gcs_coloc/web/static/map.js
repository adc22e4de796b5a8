// The map: an east-north grid in metres about the fleet's origin, over tiles where there are some.

import { byId, svg } from "./dom.js";
import { LIGHT_WORDS, SIGNS } from "./palette.js";
import { Roving } from "./roving.js";

const L = window.L;
const GRID_PX = 110;
const TRAIL_POINTS = 180;
const MARKS = ["estimate", "claim", "truth"];
const MOVING_KEY = /^(Arrow.*|[-+=_])$/;
const at = (enu) => [enu[1], enu[0]];

export class FleetMap {
  constructor(onSelect) {
    this.onSelect = onSelect;
    this.marks = new Map();
    this.ranges = new Map();
    this.prints = new WeakMap();
    this.selected = null;
    this.origin = null;
    this.mode = "all"; // what the map keeps in view: "all", the "selected" vehicle, or what the "user" chose
    this.map = L.map("map", {
      crs: L.CRS.Simple, minZoom: -9, maxZoom: 7, zoomSnap: 0.25, attributionControl: false, zoomControl: false, center: [0, 0], zoom: 0, fadeAnimation: false, zoomAnimation: false,
    });
    L.control.zoom({ position: "bottomright" }).addTo(this.map);
    new ResizeObserver(() => this.map.invalidateSize({ animate: false })).observe(byId("map"));
    const marks = this.map.getPane("markerPane");
    marks.setAttribute("role", "toolbar");
    marks.setAttribute("aria-label", "Vehicles on the map, arrow keys go from one to the next");
    this.roving = new Roving(marks);
    this.tiles = null;
    this.map.createPane("grid").classList.add("grid-pane");
    this.grid = L.layerGroup().addTo(this.map);
    this.gridRenderer = L.svg({ pane: "grid" });
    this.map.on("moveend zoomend resize", () => this.drawGrid());
    const taken = () => { this.mode = "user"; };
    this.map.on("dragstart", taken);
    byId("map").addEventListener("wheel", taken, { passive: true });
    byId("map").addEventListener("keydown", ({ target, key }) => {
      if (target.id === "map" && MOVING_KEY.test(key)) taken();
    });
    document.querySelector(".leaflet-control-zoom").addEventListener("click", taken);
    byId("fit").addEventListener("click", () => { this.mode = "all"; this.fit(); });
    this.drawGrid();
  }

  // What draws them is loaded only where there are some; `info` is null where there are none.
  async showTiles(info) {
    if (info === null && this.tiles === null) return;
    const { Tiles } = await import("./tiles.js");
    this.tiles ??= new Tiles(this.map);
    this.tiles.begin(info);
    this.tiles.setOrigin(this.origin);
  }

  drawGrid() {
    this.grid.clearLayers();
    const bounds = this.map.getBounds();
    const rough = GRID_PX / 2 ** this.map.getZoom();
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((f) => f * decade).find((s) => s >= rough);
    const line = (from, to, value) => L.polyline([from, to], {
      renderer: this.gridRenderer, interactive: false, className: value === 0 ? "grid-axis" : "grid-line",
    }).addTo(this.grid);
    const label = (point, text, className) => L.marker(point, {
      interactive: false, keyboard: false, icon: L.divIcon({ className, html: text, iconSize: null }),
    }).addTo(this.grid).getElement().setAttribute("aria-hidden", "true");
    const [south, north, west, east] = [bounds.getSouth(), bounds.getNorth(), bounds.getWest(), bounds.getEast()];
    for (let e = Math.ceil(west / step) * step; e < east; e += step) {
      line([south, e], [north, e], Math.round(e / step));
      label([south, e], `${+e.toPrecision(12)} m E`, "grid-label east");
    }
    for (let n = Math.ceil(south / step) * step; n < north; n += step) {
      line([n, west], [n, east], Math.round(n / step));
      label([n, west], `${+n.toPrecision(12)} m N`, "grid-label north");
    }
  }

  restoreTrail(sysid, east, north) {
    const mark = this.markOf(sysid);
    mark.trail.setLatLngs(east.flatMap((e, i) => (e === null ? [] : [[north[i], e]])).slice(-TRAIL_POINTS));
  }

  // Another run of the service may have another origin: nothing drawn before means anything then.
  clear() {
    for (const mark of this.marks.values()) {
      for (const [key, part] of Object.entries(mark)) {
        if (MARKS.includes(key)) this.roving.remove(part.getElement());
        part.remove();
      }
    }
    for (const line of this.ranges.values()) line.remove();
    this.marks.clear();
    this.ranges.clear();
  }

  extendTrails(vehicles) {
    for (const { view } of vehicles) {
      if (view.enu_m === null) continue;
      const trail = this.markOf(view.sysid).trail;
      trail.setLatLngs([...trail.getLatLngs(), at(view.enu_m)].slice(-TRAIL_POINTS));
    }
  }

  markOf(sysid) {
    let mark = this.marks.get(sysid);
    if (mark === undefined) {
      mark = { trail: L.polyline([], { className: "trail", interactive: false }).addTo(this.map) };
      this.marks.set(sysid, mark);
    }
    return mark;
  }

  show(frame) {
    this.origin = frame.origin;
    this.tiles?.setOrigin(frame.origin);
    const places = new Map();
    for (const vehicle of frame.vehicles) {
      const { view } = vehicle;
      if (view.enu_m !== null) places.set(view.sysid, view.enu_m);
      this.showVehicle(vehicle);
    }
    byId("truth-key").hidden = !frame.vehicles.some((vehicle) => vehicle.truth_enu_m !== null);
    this.showRanges(frame.ranges, places);
    if (this.mode === "all") this.fit();
    if (this.mode === "selected" && places.has(this.selected)) this.map.setView(at(places.get(this.selected)), undefined, { animate: false });
  }

  showVehicle(vehicle) {
    const { view, light, ellipse } = vehicle;
    const mark = this.markOf(view.sysid);
    const trusted = view.gps_state === "healthy";
    const stale = view.age_s > 3;
    const words = `Vehicle ${view.sysid}, ${LIGHT_WORDS[light]}`;
    this.place(view.sysid, "estimate", view.enu_m, `${words}: our estimate`, () => estimateIcon(view, light, stale));
    this.place(view.sysid, "claim", trusted ? null : view.reported_enu_m, `Vehicle ${view.sysid}: its own claim, not believed`, () => claimIcon(view));
    this.place(view.sysid, "truth", vehicle.truth_enu_m, `Vehicle ${view.sysid}: the truth, as its simulation has it`, () => truthIcon(view));
    const drawEllipse = view.enu_m !== null && ellipse !== null && !trusted;
    this.shape(mark, "ellipse", drawEllipse ? ellipsePoints(view.enu_m, ellipse) : [], "ellipse", true);
    const both = !trusted && view.enu_m !== null && view.reported_enu_m !== null;
    this.shape(mark, "difference", both ? [at(view.enu_m), at(view.reported_enu_m)] : [], "difference", false);
  }

  place(sysid, key, enu, title, icon) {
    const mark = this.marks.get(sysid);
    if (enu === null) {
      if (mark[key] === undefined) return;
      this.roving.remove(mark[key].getElement());
      mark[key].remove();
      delete mark[key];
      return;
    }
    const html = icon();
    const print = html.outerHTML;
    if (mark[key] === undefined) {
      const divIcon = L.divIcon({ className: `mark ${key}-mark`, html, iconSize: [34, 34] });
      mark[key] = L.marker(at(enu), { icon: divIcon, zIndexOffset: key === "estimate" ? 1000 : 0 }).addTo(this.map);
      mark[key].on("click", () => this.onSelect(sysid, false));
      mark[key].on("keypress", ({ originalEvent }) => {
        if (originalEvent.key !== "Enter" && originalEvent.key !== " ") return;
        originalEvent.preventDefault();
        this.onSelect(sysid, true);
      });
      this.roving.add(mark[key].getElement(), sysid * MARKS.length + MARKS.indexOf(key));
    } else {
      mark[key].setLatLng(at(enu));
      if (this.prints.get(mark[key]) !== print) mark[key].getElement().replaceChildren(html);
    }
    this.prints.set(mark[key], print);
    const element = mark[key].getElement();
    if (element.getAttribute("aria-label") !== title) element.setAttribute("aria-label", title);
    element.classList.toggle("selected", key === "estimate" && this.selected === sysid);
  }

  shape(mark, key, points, className, closed) {
    if (mark[key] === undefined) {
      const make = closed ? L.polygon : L.polyline;
      mark[key] = make([], { className, interactive: false, smoothFactor: 0 }).addTo(this.map);
    }
    mark[key].setLatLngs(points);
  }

  showRanges(ranges, places) {
    const seen = new Set();
    for (const range of ranges) {
      const [a, b] = [places.get(range.from_sysid), places.get(range.to_sysid)];
      if (a === undefined || b === undefined) continue;
      const key = `${range.from_sysid}-${range.to_sysid}`;
      seen.add(key);
      const className = rangeClass(range);
      let line = this.ranges.get(key);
      if (line === undefined || line.options.className !== className) {
        line?.remove();
        line = L.polyline([at(a), at(b)], { className, weight: 2 }).addTo(this.map);
        line.bindTooltip("", { sticky: true });
        line.getElement().tabIndex = -1; // Leaflet listens for its focus, which makes it a stop of the Tab key
        this.ranges.set(key, line);
      }
      line.setLatLngs([at(a), at(b)]);
      const verdict = range.refused === null ? "used" : `refused: ${range.refused}`;
      line.setTooltipContent(document.createTextNode(
        `${range.from_sysid} to ${range.to_sysid}: residual ${range.innovation_m.toFixed(1)} m of sigma ${range.sigma_m.toFixed(1)} m, ${range.age_s.toFixed(1)} s old, ${verdict}`,
      ));
    }
    for (const [key, line] of this.ranges) {
      if (!seen.has(key)) {
        line.remove();
        this.ranges.delete(key);
      }
    }
  }

  fit() {
    const bounds = L.latLngBounds([]);
    for (const mark of this.marks.values()) {
      for (const key of ["estimate", "claim"]) if (mark[key]) bounds.extend(mark[key].getLatLng());
      if (mark.ellipse && mark.ellipse.getLatLngs()[0]?.length) bounds.extend(mark.ellipse.getBounds());
    }
    if (!bounds.isValid()) return;
    const roomy = bounds.pad(0.15);
    // Only where a vehicle leaves the picture, or the picture is far too large: a map that creeps all the time cannot be read.
    const view = this.map.getBounds();
    const span = (b) => Math.max(b.getNorth() - b.getSouth(), b.getEast() - b.getWest());
    if (view.contains(bounds.pad(0.05)) && span(view) < 6 * Math.max(span(bounds), 20)) return;
    this.map.fitBounds(roomy, { animate: false, maxZoom: 3, padding: [30, 30] });
  }

  select(sysid) {
    this.selected = sysid;
  }

  // As close as its ellipse, its claim and its own size can be told apart.
  followSelected() {
    const mark = this.marks.get(this.selected);
    const bounds = L.latLngBounds([]);
    for (const key of ["estimate", "claim"]) if (mark?.[key]) bounds.extend(mark[key].getLatLng());
    if (mark?.ellipse.getLatLngs()[0]?.length) bounds.extend(mark.ellipse.getBounds());
    if (!bounds.isValid()) return;
    this.mode = "selected";
    this.map.fitBounds(bounds.pad(1), { animate: false, maxZoom: 6 });
  }
}

function rangeClass(range) {
  if (range.refused !== null) return "range range-refused";
  const size = Math.abs(range.innovation_m) / range.sigma_m;
  return size < 1 ? "range range-1" : size < 3 ? "range range-2" : "range range-3";
}

function ellipsePoints(enu, { semi_major_m: a, semi_minor_m: b, angle_rad: angle }) {
  return Array.from({ length: 48 }, (_, i) => {
    const t = (2 * Math.PI * i) / 48;
    const [x, y] = [a * Math.cos(t), b * Math.sin(t)];
    return [enu[1] + x * Math.sin(angle) + y * Math.cos(angle), enu[0] + x * Math.cos(angle) - y * Math.sin(angle)];
  });
}

function heading(view) {
  if (view.yaw_rad !== null) return (view.yaw_rad * 180) / Math.PI;
  const v = view.velocity_enu_mps;
  return v !== null && Math.hypot(v[0], v[1]) > 2 ? (Math.atan2(v[0], v[1]) * 180) / Math.PI : null;
}

function estimateIcon(view, light, stale) {
  const turn = heading(view);
  const body = turn === null
    ? svg("circle", { cx: 0, cy: 0, r: 9 })
    : svg("path", { d: "M0 -14L9 11L0 6L-9 11Z", transform: `rotate(${turn.toFixed(0)})` });
  return svg("svg", { class: `vehicle ${light}${stale ? " stale" : ""}`, viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    body, svg("text", { class: "name", x: 15, y: -7 }, `${view.sysid} ${SIGNS[light]}`));
}

function truthIcon(view) {
  return svg("svg", { class: "vehicle truth", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("path", { d: "M0 -13V-4M0 4V13M-13 0H-4M4 0H13" }), svg("circle", { cx: 0, cy: 0, r: 8 }),
    ...(view.gps_state === "healthy" ? [] : [svg("text", { class: "name", x: -11, y: 17, "text-anchor": "end" }, `${view.sysid} true`)]));
}

function claimIcon(view) {
  return svg("svg", { class: "vehicle claim", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("rect", { x: -8, y: -8, width: 16, height: 16 }), svg("path", { d: "M-8 -8L8 8M8 -8L-8 8" }),
    svg("text", { class: "name", x: 13, y: 17 }, `${view.sysid} claims`));
}
