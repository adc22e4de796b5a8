// The grid of the map: lines of east and north at round metres, with their values.

const L = window.L;
const GRID_PX = 110;

export class Grid {
  constructor(map) {
    this.map = map;
    map.createPane("grid").classList.add("grid-pane");
    this.layer = L.layerGroup().addTo(map);
    this.renderer = L.svg({ pane: "grid" });
    map.on("moveend zoomend resize", () => this.draw());
  }

  draw() {
    this.layer.clearLayers();
    const bounds = this.map.getBounds();
    const rough = GRID_PX / 2 ** this.map.getZoom();
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((f) => f * decade).find((s) => s >= rough);
    const line = (from, to, value) => L.polyline([from, to], {
      renderer: this.renderer, interactive: false, className: value === 0 ? "grid-axis" : "grid-line",
    }).addTo(this.layer);
    const label = (point, text, className) => L.marker(point, {
      interactive: false, keyboard: false, icon: L.divIcon({ className, html: text, iconSize: null }),
    }).addTo(this.layer).getElement().setAttribute("aria-hidden", "true");
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
}
