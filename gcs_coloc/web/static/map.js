// The map: an east-north grid in metres about the fleet's origin, over tiles where there are some.

import { byId } from "./dom.js";
import { Grid } from "./map_grid.js";
import { estimateIcon, reportedIcon, truthIcon } from "./map_icons.js";
import { labelKey, placeLabels } from "./map_labels.js";
import { vehicleName } from "./node_names.js";
import { MapReadings } from "./map_readings.js";
import { StationMarks } from "./map_stations.js";
import { LIGHT_WORDS } from "./palette.js";
import { RangeLines } from "./range_lines.js";
import { Roving } from "./roving.js";

const L = window.L;
const TRAIL_POINTS = 180;
const MARKS = ["estimate", "reported", "truth"];
const MOVING_KEY = /^(Arrow.*|[-+=_])$/;
const at = (enu) => [enu[1], enu[0]];

export class FleetMap {
  constructor(onSelect) {
    this.onSelect = onSelect;
    this.marks = new Map();
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
    this.grid = new Grid(this.map);
    this.ranges = new RangeLines(this.map);
    this.stations = new StationMarks(this.map);
    this.readings = new MapReadings(this.map);
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
    this.grid.draw();
  }

  // The code for tiles is loaded only where there are some; `info` is null where there are none.
  async showTiles(info) {
    if (info === null && this.tiles === null) return;
    const { Tiles } = await import("./tiles.js");
    this.tiles ??= new Tiles(this.map);
    this.tiles.setInfo(info);
    this.tiles.setOrigin(this.origin);
  }

  restoreTrail(sysid, east, north) {
    const mark = this.markOf(sysid);
    mark.trail.setLatLngs(east.flatMap((e, i) => (e === null ? [] : [[north[i], e]])).slice(-TRAIL_POINTS));
  }

  // Another run of the service may have another origin, for which nothing drawn before is right.
  clear() {
    for (const sysid of this.marks.keys()) this.remove(sysid);
    this.ranges.show([], new Map());
    this.stations.show([]);
    this.readings.clear();
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
    this.readings.setOrigin(frame.origin);
    const places = new Map();
    const sysids = new Set(frame.vehicles.map((v) => v.snapshot.sysid));
    for (const sysid of this.marks.keys()) if (!sysids.has(sysid)) this.remove(sysid);
    this.labels = placeLabels(this.map, frame.vehicles, frame.stations, this.selected);
    for (const vehicle of frame.vehicles) {
      const { snapshot } = vehicle;
      if (snapshot.enu_m !== null) places.set(snapshot.sysid, snapshot.enu_m);
      this.showVehicle(vehicle);
    }
    byId("truth-key").hidden = !frame.vehicles.some((vehicle) => vehicle.truth_enu_m !== null);
    byId("station-key").hidden = frame.stations.length === 0;
    this.stations.show(frame.stations);
    for (const { node, enu_m: enu } of frame.stations) if (enu !== null) places.set(node, enu);
    this.ranges.show(frame.ranges, places);
    if (this.mode === "all") this.fit();
    if (this.mode === "selected" && places.has(this.selected)) this.map.setView(at(places.get(this.selected)), undefined, { animate: false });
  }

  showVehicle(vehicle) {
    const { snapshot, light, ellipse } = vehicle;
    const mark = this.markOf(snapshot.sysid);
    const trusted = snapshot.gps_state === "healthy";
    const stale = snapshot.age_s > 3;
    const words = `${vehicleName(snapshot)}, ${LIGHT_WORDS[light]}`;
    this.place(snapshot.sysid, "estimate", snapshot.enu_m, `${words}: estimated position`, () => estimateIcon(snapshot, light, stale, this.labels.get(labelKey(snapshot.sysid, "estimate"))));
    this.place(snapshot.sysid, "reported", trusted ? null : snapshot.reported_enu_m, `${vehicleName(snapshot)}: reported position, not trusted`, () => reportedIcon(snapshot, this.labels.get(labelKey(snapshot.sysid, "reported"))));
    this.place(snapshot.sysid, "truth", vehicle.truth_enu_m, `${vehicleName(snapshot)}: true position`, () => truthIcon(snapshot));
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
      mark[key].on("click", () => (this.readings.isOn ? this.readings.measure(mark[key].getLatLng()) : this.onSelect(sysid, false)));
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

  fit() {
    const bounds = L.latLngBounds([]);
    for (const mark of this.marks.values()) {
      for (const key of ["estimate", "reported"]) if (mark[key]) bounds.extend(mark[key].getLatLng());
      if (mark.ellipse && mark.ellipse.getLatLngs()[0]?.length) bounds.extend(mark.ellipse.getBounds());
    }
    for (const place of this.stations.places()) bounds.extend(place);
    if (!bounds.isValid()) return;
    const roomy = bounds.pad(0.15);
    // Only where a vehicle leaves the map, or the map is far too large: a map that moves all the time cannot be read.
    // Nor is a vehicle seen beneath the buttons.
    const tools = byId("map-tools");
    const top = tools.offsetTop + tools.offsetHeight + 20; // a mark reaches 17 px beyond its place
    const right = document.querySelector(".leaflet-control-zoom").offsetWidth + 20;
    const { x, y } = this.map.getSize();
    const inView = L.latLngBounds(this.map.containerPointToLatLng([0, top]), this.map.containerPointToLatLng([x - right, y]));
    const span = (b) => Math.max(b.getNorth() - b.getSouth(), b.getEast() - b.getWest());
    if (inView.contains(bounds.pad(0.05)) && span(inView) < 3 * Math.max(span(bounds), 20)) return;
    this.map.fitBounds(roomy, { animate: false, maxZoom: 3, paddingTopLeft: [30, top], paddingBottomRight: [right, 30] });
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

function ellipsePoints(enu, { semi_major_m: a, semi_minor_m: b, angle_rad: angle }) {
  return Array.from({ length: 48 }, (_, i) => {
    const t = (2 * Math.PI * i) / 48;
    const [x, y] = [a * Math.cos(t), b * Math.sin(t)];
    return [enu[1] + x * Math.sin(angle) + y * Math.cos(angle), enu[0] + x * Math.cos(angle) - y * Math.sin(angle)];
  });
}

