"""`gcs-coloc check-config` and `gcs-coloc example-config`: configuration files without a flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.config.examples import EXAMPLES
from gcs_coloc.config.fleets import load_fleets
from gcs_coloc.core.errors import UsageError
from gcs_coloc.estimators.registry import load_estimator


def check_config(file: Annotated[Path, typer.Argument(help="The configuration file (TOML).", metavar="FILE")]) -> None:
    """Check a configuration file, fleet by fleet: keys, values, links, estimator, and every file that it names."""
    from gcs_coloc.links.registry import check_outs
    from gcs_coloc.links.signed_links import SignedLinks
    from gcs_coloc.sinks.mqtt import read_credentials
    from gcs_coloc.web.server import read_token
    from gcs_coloc.web.tiles import TileFile

    found = []
    for fleet in load_fleets(file, {}):
        settings = fleet.settings
        with fleet.named():
            check_outs(settings.out, settings.links)
            SignedLinks(settings.signing, settings.links, settings.out)
            load_estimator(settings.estimator.name, settings.estimator.settings)
            read_credentials(settings.mqtt)
            if settings.web.token_file:
                read_token(Path(settings.web.token_file))
            if settings.web.tiles:
                TileFile(Path(settings.web.tiles))
        whose = f"fleet {fleet.name}: " if fleet.name else ""
        found.append(f"{whose}{len(settings.links)} link(s), estimator {settings.estimator.name}")
    print(f"{file}: good; {'; '.join(found)}")


def example_config(
    name: Annotated[str, typer.Argument(help="default: every setting with its default; fleets: two fleets.")] = "default",
) -> None:
    """Print an example configuration file, to start one of your own from."""
    examples = {file.stem: file for file in sorted(EXAMPLES.glob("*.toml"))}
    if name not in examples:
        raise UsageError(f"there is no example {name!r}, but {', '.join(examples)}")
    print(examples[name].read_text(encoding="utf-8"), end="")
