"""The map over tiles from a file, in a real browser: they load under the page's own policy and are where they belong."""

from __future__ import annotations

import math

import pytest
from flight import Watched, browser, card, flying, service, wait_for, wait_until_good
from playwright.sync_api import expect
from tile_archive import write_archive
from vehicles import LAT, LON

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


def tile_of(lat_deg: float, lon_deg: float, zoom: int) -> tuple[int, int, int]:
    """The usual scheme: web Mercator, x from the west, y from the north."""
    n = 1 << zoom
    y = (1.0 - math.asinh(math.tan(math.radians(lat_deg))) / math.pi) / 2.0 * n
    return zoom, math.floor((lon_deg + 180.0) / 360.0 * n), math.floor(y)


def test_tiles_are_under_the_vehicles_and_nothing_is_complained_of(tmp_path):
    tiles = set()
    for zoom in range(10, 17):
        _, x, y = tile_of(LAT, LON, zoom)
        tiles |= {(zoom, x + dx, y + dy) for dx in range(-8, 9) for dy in range(-8, 9)}
    write_archive(tmp_path / "map.pmtiles", tiles)
    (tmp_path / "coloc.toml").write_text(f'[web]\ntiles = "{tmp_path / "map.pmtiles"}"\n')
    port = free_port()
    arguments = ["--config", str(tmp_path / "coloc.toml"), "--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    with service(tmp_path / "log", *arguments) as (_, url), flying(port, {4}), browser() as chromium:
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        watched = Watched(page)
        page.goto(url)
        # From here on nothing moves on the map: it shows all that it ever will.
        wait_until_good(page, 1, 2, 3)
        expect(card(page, 4)).to_contain_text("sending 3D fix")
        expect(page.get_by_text("© Nobody at all")).to_be_visible()
        pictures = page.locator(".tiles-pane img")
        loaded = "all => all.length > 0 && all.every(e => e.complete && e.naturalWidth === 256)"
        wait_for(lambda: pictures.evaluate_all(loaded), "tiles")
        # Vehicle 1 stands at the origin: its mark is on the very tile that holds that place, as far from its edges. All boxes of
        # one moment, for the map moves where the ellipse of vehicle 4 grows.
        mark, boxes = page.evaluate("""() => {
            const box = (e) => { const { x, y, width, height } = e.getBoundingClientRect(); return { x, y, width, height }; };
            const mark = document.querySelector('#map [aria-label="Vehicle 1, good: estimated position"]');
            return [box(mark), [...document.querySelectorAll(".tiles-pane img")].map((e) => [e.src, box(e)])];
        }""")
        at = (mark["x"] + mark["width"] / 2, mark["y"] + mark["height"] / 2)
        [zoom] = {int(source.split("/")[-3]) for source, _ in boxes}
        [box] = [box for source, box in boxes if source.endswith(f"/tiles/{'/'.join(map(str, tile_of(LAT, LON, zoom)))}")]
        n = 1 << zoom
        x = (LON + 180.0) / 360.0 * n % 1.0
        y = (1.0 - math.asinh(math.tan(math.radians(LAT))) / math.pi) / 2.0 * n % 1.0
        assert at[0] == pytest.approx(box["x"] + x * box["width"], abs=3.0)
        assert at[1] == pytest.approx(box["y"] + y * box["height"], abs=3.0)
        assert watched.complaints == []
