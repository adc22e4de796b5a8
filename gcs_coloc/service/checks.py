"""Checks of a configuration beyond its keys and values.

They concern links, estimators, and the files that it names.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.config.fleets import FleetOf
from gcs_coloc.core.errors import UsageError
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.links.base import check_outs
from gcs_coloc.links.signed_links import SignedLinks, read_key
from gcs_coloc.sinks.broker_connection import read_credentials
from gcs_coloc.web.server import read_token
from gcs_coloc.web.tiles import TileFile


def check_fleets(path: Path | None, fleets: Iterable[FleetOf]) -> None:
    """Check each fleet of the configuration file `path`, and read every file that it names.

    Raises:
        GcsColocError: something is wrong; the text names the fleet, the setting and the remedy.
    """
    for fleet in fleets:
        settings = fleet.settings
        with fleet.named():
            if not settings.links:
                raise UsageError(f'{path}: no link to listen on; write links = ["udpin:0.0.0.0:14550"], or another link, into it')
            check_outs(settings.out, settings.links)
            SignedLinks(settings.signing, settings.links, settings.out)
            load_estimator(settings.estimator.name, settings.estimator.settings)
            read_credentials(settings.mqtt)
            if settings.standby.key_file:
                read_key(Path(settings.standby.key_file))
            if settings.web.token_file:
                read_token(Path(settings.web.token_file))
            if settings.web.tiles:
                TileFile(Path(settings.web.tiles)).close()
