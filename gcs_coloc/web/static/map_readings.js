// What is read off the map: the position under the cursor, and the distance and bearing between two points.

import { byId, setText } from "./dom.js";
import { geodetic } from "./geodesy.js";

const L = window.L;
const LENGTH = (m) => (m < 10000 ? `${m.toFixed(m < 100 ? 1 : 0)} m` : `${(m / 1000).toFixed(2)} km`);

export class MapReadings {
  constructor(map) {
    this.map = map;
    this.origin = null;
    this.points = [];
    this.line = L.polyline([], { className: "distance", interactive: false }).addTo(map);
    map.on("mousemove", ({ latlng }) => {
      this.cursor = latlng;
      this.read();
    });
    map.on("mouseout", () => {
      this.cursor = null;
      this.read();
    });
    map.on("click", ({ latlng }) => this.measure(latlng));
    byId("distance").addEventListener("click", () => this.toggle());
    byId("map-panel").addEventListener("keydown", ({ key }) => {
      if (key === "Escape" && this.isOn) this.toggle();
    });
  }

  setOrigin(origin) {
    this.origin = origin;
  }

  get isOn() {
    return byId("distance").getAttribute("aria-pressed") === "true";
  }

  toggle() {
    const on = !this.isOn;
    byId("distance").setAttribute("aria-pressed", String(on));
    byId("map").classList.toggle("measuring", on);
    if (on) this.map.doubleClickZoom.disable(); // two clicks are two points
    else this.map.doubleClickZoom.enable();
    this.clear();
  }

  clear() {
    this.points = [];
    this.read();
  }

  // The third point begins anew.
  measure(latlng) {
    if (!this.isOn) return;
    this.points = this.points.length === 2 ? [latlng] : [...this.points, latlng];
    this.read();
  }

  read() {
    const cursor = this.cursor ?? null;
    const [a, b = cursor] = this.points;
    this.line.setLatLngs(a && b ? [a, b] : []);
    setText(byId("distance-text"), !this.isOn ? "" : !a || !b ? "click two points" : between(a, b));
    setText(byId("cursor-text"), cursor === null || this.origin === null ? "" : this.position(cursor));
  }

  position({ lat: north, lng: east }) {
    const [lat, lon] = geodetic(this.origin, east, north);
    return `${lat.toFixed(6)}, ${lon.toFixed(6)}   ${east.toFixed(0)} m E, ${north.toFixed(0)} m N`;
  }
}

function between(a, b) {
  const [east, north] = [b.lng - a.lng, b.lat - a.lat];
  const bearing = ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
  return `${LENGTH(Math.hypot(east, north))}, bearing ${String(Math.round(bearing) % 360).padStart(3, "0")}\u00b0`;
}
