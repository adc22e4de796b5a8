"""Tiles come out of an archive as they went in; what is no archive of pictures is refused by name."""

from __future__ import annotations

import pytest
from pmtiles.tile import TileType
from tile_archive import png, write_archive

from gcs_coloc.core.errors import ConfigError
from gcs_coloc.web.tiles import TileFile


def test_every_tile_comes_out_as_it_went_in_and_no_other(tmp_path):
    path = tmp_path / "map.pmtiles"
    # More than one directory holds, so that there are leaves.
    write_archive(path, [(zoom, x, y) for zoom, n in ((0, 1), (3, 8), (7, 100)) for x in range(n) for y in range(n)])
    tiles = TileFile(path)
    assert tiles.tile(0, 0, 0) == png(190, 200, 160)
    assert tiles.tile(7, 98, 99) == png(120, 160, 110)
    for missing in ((1, 0, 0), (7, 127, 127), (3, 8, 0), (-1, 0, 0), (40, 0, 0), (3, -1, 0)):
        assert tiles.tile(*missing) is None
    assert (tiles.info.min_zoom, tiles.info.max_zoom, tiles.media_type) == (0, 7, "image/png")
    assert tiles.info.attribution == "© Nobody at all"


@pytest.mark.parametrize("content", [b"", b"PMTiles", b"PMTiles\x02" + bytes(200), b"\xff" * 500])
def test_what_is_no_archive_is_refused_by_name(tmp_path, content):
    (tmp_path / "no.pmtiles").write_bytes(content)
    with pytest.raises(ConfigError, match=r"web.tiles: .*no.pmtiles: is no whole PMTiles file of version 3"):
        TileFile(tmp_path / "no.pmtiles")


def test_a_file_that_is_not_there_and_tiles_that_are_no_pictures_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"web.tiles: .*: cannot be read: No such file"):
        TileFile(tmp_path / "none.pmtiles")
    write_archive(tmp_path / "vector.pmtiles", [(0, 0, 0)], TileType.MVT)
    with pytest.raises(ConfigError, match="holds MVT tiles; pictures are wanted"):
        TileFile(tmp_path / "vector.pmtiles")


def test_of_an_archive_that_is_cut_off_the_tiles_that_are_left_come_out(tmp_path):
    path = tmp_path / "map.pmtiles"
    write_archive(path, [(1, 0, 0), (1, 0, 1)])
    path.write_bytes(path.read_bytes()[:-1])
    assert TileFile(path).tile(1, 0, 0) == png(190, 200, 160)
    assert TileFile(path).tile(1, 0, 1) is None
