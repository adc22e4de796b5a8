"""Raster tiles under the map, from one PMTiles file on this machine.

Format: PMTiles version 3, protomaps/PMTiles spec.
"""

from __future__ import annotations

import gzip
import json
import os
import re
import zlib
from functools import lru_cache
from html import unescape
from pathlib import Path
from typing import Any

from pmtiles.tile import (
    Compression,
    MagicNumberNotFound,
    SpecVersionUnsupported,
    TileType,
    deserialize_directory,
    deserialize_header,
    find_tile,
    zxy_to_tileid,
)

from gcs_coloc.core.errors import ConfigError
from gcs_coloc.runtime.files import reading
from gcs_coloc.web.wire import TilesInfo

_HEADER_BYTES = 127  # source: PMTiles specification, version 3
_MAX_DEPTH = 4  # of directories; same source
_DIRECTORIES_KEPT = 64
_MAX_BYTES = 10_000_000
"""A tile or directory of more bytes means a damaged file. Chosen: a hundred times a large tile."""
_DAMAGED = (OSError, EOFError, ValueError, IndexError, OverflowError, RecursionError, zlib.error)
"""The errors of reading a damaged header, directory or description: its bytes, gzip, numbers and JSON."""
_MEDIA_TYPES = {
    TileType.PNG: "image/png",
    TileType.JPEG: "image/jpeg",
    TileType.WEBP: "image/webp",
    TileType.AVIF: "image/avif",
}


class TileFile:
    """One archive of map tiles.

    `tile` may be called from any thread. `media_type` is of every tile, `info` is for the page.
    """

    def __init__(self, path: Path) -> None:
        """Open the archive and read what it holds.

        Raises:
            ConfigError: it cannot be read, is no PMTiles file of version 3, or holds no pictures.
        """
        self._where = f"web.tiles: {path}"
        with reading(self._where, ConfigError):
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        self._directory = lru_cache(_DIRECTORIES_KEPT)(self._read_directory)
        try:
            self._header = deserialize_header(os.pread(self._fd, _HEADER_BYTES, 0))
            metadata = self._metadata()
        except (MagicNumberNotFound, SpecVersionUnsupported, *_DAMAGED):
            self.close()
            raise ConfigError(f"{self._where}: is no whole PMTiles file of version 3") from None
        if self._header["tile_type"] not in _MEDIA_TYPES or self._header["tile_compression"] is not Compression.NONE:
            self.close()
            kind = self._header["tile_type"].name
            raise ConfigError(f"{self._where}: holds {kind} tiles; pictures are wanted (png, jpeg, webp, avif), uncompressed")
        self.media_type = _MEDIA_TYPES[self._header["tile_type"]]
        # Often a link in HTML, of which the page shows the text.
        attribution = unescape(re.sub("<[^>]*>", "", str(metadata.get("attribution", "")))).strip()
        self.info = TilesInfo(
            min_zoom=self._header["min_zoom"],
            max_zoom=self._header["max_zoom"],
            attribution=attribution,
        )

    def close(self) -> None:
        """Close the archive; it has no tiles any more."""
        os.close(self._fd)

    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """Return one tile of the usual scheme (web Mercator, y from north).

        None where there is none, or the file is damaged there.
        """
        if not 0 <= zoom <= 30 or not (0 <= x < 1 << zoom and 0 <= y < 1 << zoom):
            return None
        tile_id = zxy_to_tileid(zoom, x, y)
        offset, length = self._header["root_offset"], self._header["root_length"]
        try:
            for _ in range(_MAX_DEPTH):
                entry = find_tile(self._directory(offset, length), tile_id)
                if entry is None or entry.length > _MAX_BYTES:
                    return None
                if entry.run_length > 0:
                    data = os.pread(self._fd, entry.length, self._header["tile_data_offset"] + entry.offset)
                    return data if len(data) == entry.length else None
                offset, length = self._header["leaf_directory_offset"] + entry.offset, entry.length
        except _DAMAGED:
            pass
        return None

    def _read_directory(self, offset: int, length: int) -> Any:
        return deserialize_directory(self._read(length, offset))

    def _read(self, length: int, offset: int) -> bytes:
        if length > _MAX_BYTES:
            raise ValueError(f"{length} bytes")
        return os.pread(self._fd, length, offset)

    def _metadata(self) -> dict[str, Any]:
        data = self._read(self._header["metadata_length"], self._header["metadata_offset"])
        found = json.loads(gzip.decompress(data) if self._header["internal_compression"] is Compression.GZIP else data)
        return found if isinstance(found, dict) else {}
