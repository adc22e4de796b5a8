// The map: an east-north grid in metres about the fleet's origin, over tiles where there are some.

import { byId, svg } from "./dom.js";
import { nodeName } from "./node_names.js";
import { LIGHT_WORDS, SEVERITY, SIGNS } from "./palette.js";
import { Roving } from "./roving.js";

const L = window.L;
const GRID_PX = 110;
const TRAIL_POINTS = 180;
const MARKS = ["estimate", "reported", "truth"];
// Where a vehicle's label stands about its mark, in order of preference: x, y of its baseline, and its anchor; px.
const LABEL_PLACES = [[15, -7, "start"], [15, 19, "start"], [-15, -7, "end"], [-15, 19, "end"]];
const LABEL_PX = { character: 9, height: 15, mark: 11 };
const MOVING_KEY = /^(Arrow.*|[-+=_])$/;
const at = (enu) => [enu[1], enu[0]];

export class FleetMap {
  constructor(onSelect) {
    this.onSelect = onSelect;
    this.marks = new Map();
    this.ranges = new Map();
    this.stations = new Map();
    this.drawn = new WeakMap();
    this.selected = null;
    this.origin = null;
    this.mode = "all"; // what the map keeps in view: "all", the "selected" vehicle, or nothing since the "user" moved it
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
    const keepUserView = () => { this.mode = "user"; };
    this.map.on("dragstart dblclick", keepUserView);
    byId("map").addEventListener("touchstart", ({ touches }) => {
      if (touches.length > 1) keepUserView();
    }, { passive: true });
    byId("map").addEventListener("wheel", keepUserView, { passive: true });
    byId("map").addEventListener("keydown", ({ target, key }) => {
      if (target.id === "map" && MOVING_KEY.test(key)) keepUserView();
    });
    document.querySelector(".leaflet-control-zoom").addEventListener("click", keepUserView);
    byId("fit").addEventListener("click", () => { this.mode = "all"; this.fit(); });
    this.drawGrid();
  }

  // The code for tiles is loaded only where there are some; `info` is null where there are none.
  async showTiles(info) {
    if (info === null && this.tiles === null) return;
    const { Tiles } = await import("./tiles.js");
    this.tiles ??= new Tiles(this.map);
    this.tiles.setInfo(info);
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

  // Another run of the service may have another origin, for which nothing drawn before is right.
  clear() {
    for (const sysid of this.marks.keys()) this.remove(sysid);
    for (const line of this.ranges.values()) line.remove();
    this.ranges.clear();
    this.showStations([], new Map());
  }

  remove(sysid) {
    for (const [key, part] of Object.entries(this.marks.get(sysid))) {
      if (MARKS.includes(key)) this.roving.remove(part.getElement());
      part.remove();
    }
    this.marks.delete(sysid);
  }

  extendTrails(vehicles) {
    for (const { snapshot } of vehicles) {
      if (snapshot.enu_m === null) continue;
      const trail = this.markOf(snapshot.sysid).trail;
      trail.setLatLngs([...trail.getLatLngs(), at(snapshot.enu_m)].slice(-TRAIL_POINTS));
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
    const sysids = new Set(frame.vehicles.map((v) => v.snapshot.sysid));
    for (const sysid of this.marks.keys()) if (!sysids.has(sysid)) this.remove(sysid);
    this.labels = this.placeLabels(frame.vehicles, frame.stations);
    for (const vehicle of frame.vehicles) {
      const { snapshot } = vehicle;
      if (snapshot.enu_m !== null) places.set(snapshot.sysid, snapshot.enu_m);
      this.showVehicle(vehicle);
    }
    byId("truth-key").hidden = !frame.vehicles.some((vehicle) => vehicle.truth_enu_m !== null);
    byId("station-key").hidden = frame.stations.length === 0;
    this.showStations(frame.stations, places);
    this.showRanges(frame.ranges, places);
    if (this.mode === "all") this.fit();
    if (this.mode === "selected" && places.has(this.selected)) this.map.setView(at(places.get(this.selected)), undefined, { animate: false });
  }

  // Labels cover neither each other nor a mark; the selected vehicle's and the most serious are placed first. One without room
  // is left out.
  placeLabels(vehicles, stations) {
    const located = vehicles.filter(({ snapshot }) => snapshot.enu_m !== null);
    const points = new Map(located.map(({ snapshot }) => [snapshot.sysid, this.map.latLngToContainerPoint(at(snapshot.enu_m))]));
    const { character, height, mark } = LABEL_PX;
    const taken = [...points].map(([sysid, { x, y }]) => [sysid, x - mark, y - mark, x + mark, y + mark]);
    for (const { enu_m: enu } of stations) {
      if (enu === null) continue;
      const { x, y } = this.map.latLngToContainerPoint(at(enu));
      taken.push([null, x - mark, y - mark, x + mark, y + mark]);
    }
    // The marks of reported positions have their own labels, always at the same side.
    for (const { snapshot: { sysid, gps_state, reported_enu_m: enu } } of vehicles) {
      if (gps_state === "healthy" || enu === null) continue;
      const { x, y } = this.map.latLngToContainerPoint(at(enu));
      taken.push([null, x + 13, y + 19 - height, x + 13 + (String(sysid).length + 9) * 7.5, y + 19]);
    }
    const labels = new Map();
    const rank = ({ snapshot, light }) => (snapshot.sysid === this.selected ? -1 : SEVERITY[light]);
    for (const { snapshot: { sysid } } of located.sort((a, b) => rank(a) - rank(b) || a.snapshot.sysid - b.snapshot.sysid)) {
      const { x, y } = points.get(sysid);
      const width = (String(sysid).length + 2) * character;
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

  showVehicle(vehicle) {
    const { snapshot, light, ellipse } = vehicle;
    const mark = this.markOf(snapshot.sysid);
    const trusted = snapshot.gps_state === "healthy";
    const stale = snapshot.age_s > 3;
    const words = `Vehicle ${snapshot.sysid}, ${LIGHT_WORDS[light]}`;
    this.place(snapshot.sysid, "estimate", snapshot.enu_m, `${words}: estimated position`, () => estimateIcon(snapshot, light, stale, this.labels.get(snapshot.sysid)));
    this.place(snapshot.sysid, "reported", trusted ? null : snapshot.reported_enu_m, `Vehicle ${snapshot.sysid}: reported position, not trusted`, () => reportedIcon(snapshot));
    this.place(snapshot.sysid, "truth", vehicle.truth_enu_m, `Vehicle ${snapshot.sysid}: true position`, () => truthIcon(snapshot));
    const drawEllipse = snapshot.enu_m !== null && ellipse !== null && !trusted;
    this.shape(mark, "ellipse", drawEllipse ? ellipsePoints(snapshot.enu_m, ellipse) : [], "ellipse", true);
    const both = !trusted && snapshot.enu_m !== null && snapshot.reported_enu_m !== null;
    this.shape(mark, "difference", both ? [at(snapshot.enu_m), at(snapshot.reported_enu_m)] : [], "difference", false);
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
    const markup = html.outerHTML;
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
      if (this.drawn.get(mark[key]) !== markup) mark[key].getElement().replaceChildren(html);
    }
    this.drawn.set(mark[key], markup);
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

  showStations(stations, places) {
    const seen = new Set();
    for (const station of stations) {
      if (station.enu_m === null) continue;
      const { node } = station;
      places.set(node, station.enu_m);
      seen.add(node);
      const words = stationWords(station);
      let mark = this.stations.get(node);
      if (mark === undefined) {
        const icon = L.divIcon({ className: "mark station-mark", html: stationIcon(station), iconSize: [34, 34] });
        mark = L.marker(at(station.enu_m), { icon, keyboard: false, zIndexOffset: -1000 }).addTo(this.map);
        mark.bindTooltip("");
        mark.getElement().setAttribute("role", "img");
        this.stations.set(node, mark);
      }
      mark.setLatLng(at(station.enu_m));
      mark.setTooltipContent(document.createTextNode(words));
      const element = mark.getElement();
      if (element.getAttribute("aria-label") !== words) element.setAttribute("aria-label", words);
      element.classList.toggle("wrong", station.fault !== null);
    }
    for (const [node, mark] of this.stations) {
      if (seen.has(node)) continue;
      mark.remove();
      this.stations.delete(node);
    }
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
      const use = range.refused === null ? "used" : `refused: ${range.refused}`;
      line.setTooltipContent(document.createTextNode(
        `${nodeName(range.from_sysid)} to ${nodeName(range.to_sysid)}: residual ${range.innovation_m.toFixed(1)} m of sigma ${range.sigma_m.toFixed(1)} m, ${range.age_s.toFixed(1)} s old, ${use}`,
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
      for (const key of ["estimate", "reported"]) if (mark[key]) bounds.extend(mark[key].getLatLng());
      if (mark.ellipse && mark.ellipse.getLatLngs()[0]?.length) bounds.extend(mark.ellipse.getBounds());
    }
    for (const mark of this.stations.values()) bounds.extend(mark.getLatLng());
    if (!bounds.isValid()) return;
    const roomy = bounds.pad(0.15);
    // Only where a vehicle leaves the map, or the map is far too large: a map that moves all the time cannot be read.
    const inView = this.map.getBounds();
    const span = (b) => Math.max(b.getNorth() - b.getSouth(), b.getEast() - b.getWest());
    if (inView.contains(bounds.pad(0.05)) && span(inView) < 3 * Math.max(span(bounds), 20)) return;
    this.map.fitBounds(roomy, { animate: false, maxZoom: 3, padding: [30, 30] });
  }

  select(sysid) {
    this.selected = sysid;
  }

  // So close that its ellipse, its reported position and its mark are seen apart.
  followSelected() {
    const mark = this.marks.get(this.selected);
    const bounds = L.latLngBounds([]);
    for (const key of ["estimate", "reported"]) if (mark?.[key]) bounds.extend(mark[key].getLatLng());
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

function heading(snapshot) {
  if (snapshot.yaw_rad !== null) return (snapshot.yaw_rad * 180) / Math.PI;
  const v = snapshot.velocity_enu_mps;
  return v !== null && Math.hypot(v[0], v[1]) > 2 ? (Math.atan2(v[0], v[1]) * 180) / Math.PI : null;
}

function estimateIcon(snapshot, light, stale, label) {
  const turn = heading(snapshot);
  const body = turn === null
    ? svg("circle", { cx: 0, cy: 0, r: 9 })
    : svg("path", { d: "M0 -14L9 11L0 6L-9 11Z", transform: `rotate(${turn.toFixed(0)})` });
  return svg("svg", { class: `vehicle ${light}${stale ? " stale" : ""}`, viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    body, ...(label === undefined ? [] : [svg("text", { class: "name", x: label[0], y: label[1], "text-anchor": label[2] }, `${snapshot.sysid} ${SIGNS[light]}`)]));
}

function stationWords({ node, name, sigma_h_m: sigma, source, range_age_s: age, fault }) {
  const ranged = age === null ? "not ranged yet" : age > 5 ? "not ranged now" : "ranged";
  return `${nodeName(node)}${name ? ` (${name})` : ""}, ${source}, 1-sigma ${sigma.toFixed(1)} m, ${ranged}${fault === null ? "" : `; ${fault}`}`;
}

function stationIcon({ station_id: id }) {
  return svg("svg", { class: "station", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("path", { d: "M0 -9L8 7H-8Z" }), svg("text", { class: "name", x: 0, y: 19, "text-anchor": "middle" }, `S${id}`));
}

function truthIcon(snapshot) {
  return svg("svg", { class: "vehicle truth", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("path", { d: "M0 -13V-4M0 4V13M-13 0H-4M4 0H13" }), svg("circle", { cx: 0, cy: 0, r: 8 }),
    ...(snapshot.gps_state === "healthy" ? [] : [svg("text", { class: "name", x: -11, y: 17, "text-anchor": "end" }, `${snapshot.sysid} true`)]));
}

function reportedIcon(snapshot) {
  return svg("svg", { class: "vehicle reported", viewBox: "-17 -17 34 34", width: 34, height: 34, "aria-hidden": "true" },
    svg("rect", { x: -8, y: -8, width: 16, height: 16 }), svg("path", { d: "M-8 -8L8 8M8 -8L-8 8" }),
    svg("text", { class: "name", x: 13, y: 17 }, `${snapshot.sysid} reported`));
}
