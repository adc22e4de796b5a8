// Raster tiles under the map. Each tile is placed by its own corners in the east-north frame: web Mercator and that frame
// differ in scale and direction over tens of kilometres, but not within one tile.

import { byId, setText } from "./dom.js";
import { eastNorth, geodetic, rad } from "./geodesy.js";

const L = window.L;
const MOST = 80;
const EQUATOR_M = 40075016.686;

const lonOf = (x, z) => (x / 2 ** z) * 360 - 180;
const latOf = (y, z) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** z))) * 180) / Math.PI;
const xOf = (lon, z) => Math.floor(((lon + 180) / 360) * 2 ** z);
const yOf = (lat, z) => Math.floor(((1 - Math.asinh(Math.tan(rad(lat))) / Math.PI) / 2) * 2 ** z);

export class Tiles {
  constructor(map) {
    this.map = map;
    map.createPane("tiles").classList.add("tiles-pane");
    this.layers = new Map();
    this.info = null;
    this.origin = null;
    map.on("moveend zoomend resize", () => this.draw());
  }

  // `info` is null where no tiles are set, `origin` the frame's: latitude, longitude in degrees, height in metres.
  setInfo(info) {
    this.info = info;
    setText(byId("tiles-by"), info?.attribution ?? "");
    this.draw();
  }

  setOrigin(origin) {
    if (String(origin) === String(this.origin)) return;
    this.origin = origin;
    this.clear();
    this.draw();
  }

  clear() {
    for (const layer of this.layers.values()) layer.remove();
    this.layers.clear();
  }

  inSight(zoom) {
    const b = this.map.getBounds();
    const corners = [[b.getWest(), b.getSouth()], [b.getEast(), b.getSouth()], [b.getWest(), b.getNorth()], [b.getEast(), b.getNorth()]].map(([e, n]) => geodetic(this.origin, e, n));
    const [lats, lons] = [corners.map(([lat]) => Math.max(Math.min(lat, 85), -85)), corners.map(([, lon]) => lon)];
    const last = 2 ** zoom - 1;
    return {
      west: Math.max(xOf(Math.min(...lons), zoom), 0), east: Math.min(xOf(Math.max(...lons), zoom), last),
      north: Math.max(yOf(Math.max(...lats), zoom), 0), south: Math.min(yOf(Math.min(...lats), zoom), last),
    };
  }

  draw() {
    if (this.info === null || this.origin === null) return;
    const fine = Math.log2((EQUATOR_M * Math.cos(rad(this.origin[0])) * 2 ** this.map.getZoom()) / 256);
    let zoom = Math.min(Math.round(fine), this.info.max_zoom);
    let range = this.inSight(zoom);
    const count = (r) => (r.east - r.west + 1) * (r.south - r.north + 1);
    while (zoom > this.info.min_zoom && count(range) > MOST) range = this.inSight(--zoom);
    const wanted = new Set();
    if (zoom >= this.info.min_zoom && count(range) <= MOST) {
      for (let x = range.west; x <= range.east; x += 1) {
        for (let y = range.north; y <= range.south; y += 1) wanted.add(this.put(zoom, x, y));
      }
    }
    for (const [key, layer] of this.layers) {
      if (!wanted.has(key)) {
        layer.remove();
        this.layers.delete(key);
      }
    }
  }

  put(zoom, x, y) {
    const key = `${zoom}/${x}/${y}`;
    if (!this.layers.has(key)) {
      const [north, south, west, east] = [latOf(y, zoom), latOf(y + 1, zoom), lonOf(x, zoom), lonOf(x + 1, zoom)];
      const [lat, lon] = [(north + south) / 2, (west + east) / 2];
      const enu = (...at) => eastNorth(this.origin, ...at);
      const bounds = [[enu(south, lon)[1], enu(lat, west)[0]], [enu(north, lon)[1], enu(lat, east)[0]]];
      this.layers.set(key, L.imageOverlay(`/tiles/${key}`, bounds, { pane: "tiles", interactive: false, alt: "" }).addTo(this.map));
    }
    return key;
  }
}
