"""A small PMTiles archive of one-coloured pictures, for the tests of the map."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import write


@cache
def png(red: int, green: int, blue: int) -> bytes:
    """A picture of 256 by 256 points in one colour."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = (b"\0" + bytes((red, green, blue)) * 256) * 256
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 256, 256, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def write_archive(path: Path, tiles: Iterable[tuple[int, int, int]], kind: TileType = TileType.PNG) -> None:
    """An archive of the tiles (zoom, x, y), as a chessboard."""
    ordered = sorted(tiles, key=lambda tile: zxy_to_tileid(*tile))
    with write(path) as archive:
        for zoom, x, y in ordered:
            archive.write_tile(zxy_to_tileid(zoom, x, y), png(120, 160, 110) if (x + y) % 2 else png(190, 200, 160))
        header = {
            "tile_type": kind,
            "tile_compression": Compression.NONE,
            "min_zoom": min(zoom for zoom, _, _ in ordered),
            "max_zoom": max(zoom for zoom, _, _ in ordered),
        }
        archive.finalize(header, {"attribution": '<a href="https://example.org">&copy; Nobody</a> at all'})
