"""Tiles come out of an archive as they went in; what is no archive of pictures is refused by name."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from pmtiles.tile import Entry, TileType, deserialize_header, serialize_directory, serialize_header, zxy_to_tileid
from tile_archive import png, write_archive

from gcs_coloc.core.errors import ConfigError
from gcs_coloc.web.tiles import TileFile

LIGHT, DARK = png(190, 200, 160), png(120, 160, 110)

SCATTERED = random.Random(1).sample([(8, x, y) for x in range(256) for y in range(256)], 20_000)
"""So many tiles without an order that their directory does not fit into the root: it has leaves."""


def scattered_archive(path: Path) -> bytearray:
    """Write the scattered tiles and three of lower zooms; return the archive's bytes."""
    write_archive(path, [(0, 0, 0), (3, 7, 0), (3, 6, 6), *SCATTERED])
    return bytearray(path.read_bytes())


def test_every_tile_comes_out_as_it_went_in_and_no_other(tmp_path):
    path = tmp_path / "map.pmtiles"
    assert deserialize_header(bytes(scattered_archive(path)[:127]))["leaf_directory_length"] > 0
    tiles = TileFile(path)
    assert [tiles.tile(*tile) for tile in ((0, 0, 0), (3, 6, 6), (3, 7, 0))] == [LIGHT, LIGHT, DARK]
    assert all(tiles.tile(*tile) == (DARK if (tile[1] + tile[2]) % 2 else LIGHT) for tile in SCATTERED)
    absent = next((8, x, 0) for x in range(256) if (8, x, 0) not in SCATTERED)
    for missing in ((1, 0, 0), (7, 127, 127), (3, 8, 0), (-1, 0, 0), (40, 0, 0), (3, -1, 0), absent):
        assert tiles.tile(*missing) is None
    assert (tiles.info.min_zoom, tiles.info.max_zoom, tiles.media_type) == (0, 8, "image/png")
    assert tiles.info.attribution == "© Nobody at all"


@pytest.mark.parametrize("content", [b"", b"PMTiles", b"PMTiles\x02" + bytes(200), b"\xff" * 500])
def test_what_is_no_archive_is_refused_by_name(tmp_path, content):
    (tmp_path / "no.pmtiles").write_bytes(content)
    with pytest.raises(ConfigError, match=r"web.tiles: .*no.pmtiles: is no whole PMTiles file of version 3"):
        TileFile(tmp_path / "no.pmtiles")


def test_a_header_with_any_bytes_is_opened_or_refused_by_name(tmp_path):
    """The first 127 bytes and the description behind them, a few of them changed at random, many times."""
    path, rng = tmp_path / "map.pmtiles", random.Random(7)
    write_archive(path, [(1, 0, 0), (1, 0, 1)])
    whole, refused = path.read_bytes(), 0
    for _ in range(500):
        damaged = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            damaged[rng.randrange(min(len(whole), 300))] = rng.randrange(256)
        path.write_bytes(damaged)
        try:
            TileFile(path).tile(1, 0, 0)
        except ConfigError:
            refused += 1
    assert 50 < refused < 500


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
    assert TileFile(path).tile(1, 0, 0) == LIGHT
    assert TileFile(path).tile(1, 0, 1) is None


@pytest.mark.parametrize("damage", [b"\xff" * 8, b"\0" * 8, b"\x55" * 8])
def test_a_damaged_leaf_takes_only_its_own_tiles_with_it(tmp_path, damage):
    path = tmp_path / "map.pmtiles"
    content = scattered_archive(path)
    header = deserialize_header(bytes(content[:127]))
    # The beginning of what is compressed in the last leaf, right behind its gzip header.
    at = content.rindex(b"\x1f\x8b\x08", 0, header["leaf_directory_offset"] + header["leaf_directory_length"]) + 10
    content[at : at + len(damage)] = damage
    path.write_bytes(content)
    tiles = TileFile(path)
    ordered = sorted(SCATTERED, key=lambda tile: zxy_to_tileid(*tile))
    assert tiles.tile(*ordered[0]) in (LIGHT, DARK)
    assert tiles.tile(*ordered[-1]) is None


def test_a_leaf_whose_length_is_stated_as_more_than_any_files_is_not_read(tmp_path):
    path = tmp_path / "map.pmtiles"
    for offset, length in ((0, 1 << 62), (1 << 63, 100)):
        root = serialize_directory([Entry(0, offset, length, 0)])
        content = scattered_archive(path)
        header = deserialize_header(bytes(content[:127])) | {"root_offset": len(content), "root_length": len(root)}
        path.write_bytes(serialize_header(header) + content[127:] + root)
        assert TileFile(path).tile(0, 0, 0) is None
