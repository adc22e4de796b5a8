"""`[[fleet]]`: several fleets in one process, each with settings of its own.

What stands outside the fleets' tables holds for all of them; what a fleet's table says goes before it. Nothing is shared but
the process: where two fleets would share a link, a page or a name, the configuration is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_coloc.config.sections import topic_level
from gcs_coloc.config.settings import Settings, read_table, settings_of
from gcs_coloc.core.errors import ConfigError, GcsColocError, UsageError
from gcs_coloc.links.base import parse, parse_out

_SECTIONS = frozenset(Settings.model_fields) - {"fleet"}
_FLAGS_OF_ONE = {
    "links": "--udp and --link",
    "out": "--out",
    "fleet": "--failed and --healthy",
    "web": "--web",
    "standby": "--peer and --standby",
}


@dataclass(frozen=True, slots=True)
class FleetOf:
    """One fleet of a service; `name` is empty where it is the only one and needs none.

    `flagged` are the keys of its `[fleet]` that flags have set.
    """

    name: str
    settings: Settings
    flagged: frozenset[str] = frozenset()

    @contextmanager
    def named(self) -> Iterator[None]:
        """What goes wrong within is this fleet's, and says so where there are several."""
        try:
            yield
        except GcsColocError as error:
            if not self.name:
                raise
            raise type(error)(f"fleet {self.name}: {error}") from None


def load_fleets(path: Path | None, flags: Mapping[str, Any]) -> Sequence[FleetOf]:
    """The fleets of a configuration, in its order: those of its `[[fleet]]` tables, else one.

    Raises:
        ConfigError: the file cannot be read, or a key or value is wrong, or two fleets share what each must have for itself.
        UsageError: a flag says something of one fleet where there are several.
    """
    table = read_table(path) if path is not None else {}
    if not isinstance(table.get("fleet"), list):
        settings = settings_of([table], flags, str(path) if path is not None else "settings")
        return [FleetOf("", settings, frozenset(flags.get("fleet", ())))]
    for key, names in _FLAGS_OF_ONE.items():
        if key in flags and flags[key] != {"on": False}:
            raise UsageError(f"{names}: {path} is of several fleets ([[fleet]]); say it in the table of the fleet that is meant")
    return _several(path, table, flags)


def load_settings(path: Path | None, flags: Mapping[str, Any], fleet: str | None = None) -> Settings:
    """The settings of one fleet: the one called `fleet` where the configuration is of several, else the only one.

    Raises:
        ConfigError: as `load_fleets`.
        UsageError: the configuration is of several fleets and none is named, or has none of that name.
    """
    table = read_table(path) if path is not None else {}
    if not isinstance(table.get("fleet"), list):
        if fleet is not None:
            raise UsageError(f"--fleet {fleet}: {f'{path} has no [[fleet]]' if path else 'there is no --config'}: leave it out")
        return settings_of([table], flags, str(path) if path is not None else "settings")
    # All of them are read for what is wrong with any; the flags are for the one.
    names = [each.name for each in _several(path, table, {})]
    if fleet is None:
        raise UsageError(f"{path}: is of several fleets ([[fleet]]): say which with --fleet: {', '.join(names)}")
    if fleet not in names:
        raise UsageError(f"--fleet {fleet}: {path} has no such fleet, but {', '.join(names)}")
    number = names.index(fleet)
    return _fleet(path, number + 1, table, table["fleet"][number], flags).settings


def _several(path: Path | None, table: Mapping[str, Any], flags: Mapping[str, Any]) -> Sequence[FleetOf]:
    for key in ("links", "out"):
        if key in table:
            raise ConfigError(f"{path}: {key}: of which fleet? Each [[fleet]] has {key} of its own")
    fleets = [_fleet(path, number, table, own, flags) for number, own in enumerate(table["fleet"], 1)]
    _nothing_shared(path, "name", fleets, lambda fleet: [fleet.name])
    _nothing_shared(path, "links", fleets, lambda fleet: [str(parse(link)) for link in fleet.settings.links])
    _nothing_shared(path, "out", fleets, lambda fleet: [str(parse_out(out)) for out in fleet.settings.out])
    _nothing_shared(path, "web.address", fleets, _fixed_address)
    _nothing_shared(
        path, "standby.listen", fleets, lambda fleet: [fleet.settings.standby.listen] * bool(fleet.settings.standby.peer)
    )
    return fleets


def _fleet(
    path: Path | None, number: int, common: Mapping[str, Any], own: Mapping[str, Any], flags: Mapping[str, Any]
) -> FleetOf:
    source = f"{path}: fleet {number}"
    own = dict(own)
    name = own.pop("name", None)
    if not isinstance(name, str):
        raise ConfigError(f'{source}: name: each [[fleet]] needs one, as name = "north"')
    try:
        topic_level(name)  # it is a directory and a word in the log as well
    except ValueError as error:
        raise ConfigError(f"{source}: name: {error}") from None
    source = f"{source} ({name})"
    sections = {key: own.pop(key) for key in _SECTIONS & own.keys()}
    shared = {key: value for key, value in common.items() if key != "fleet"}
    settings = settings_of([sections | {"fleet": own}, shared], flags, source)
    if not settings.links:
        raise ConfigError(f"{source}: links: there is none to listen on")
    if "fleet" in settings.mqtt.model_fields_set:
        raise ConfigError(f"{source}: mqtt.fleet: the fleet's name stands in the topics; leave it out")
    record, web = settings.record, settings.web
    return FleetOf(
        name,
        settings.model_copy(
            update={
                "mqtt": settings.mqtt.model_copy(update={"fleet": name}),
                "record": record.model_copy(update={"directory": str(Path(record.directory) / name) if record.directory else ""}),
                "web": web.model_copy(update={"on": web.on and web.must_open}),
            }
        ),
    )


def _fixed_address(fleet: FleetOf) -> list[str]:
    web = fleet.settings.web
    return [web.address] if web.on and web.host_and_port()[1] != 0 else []


def _standby_address(fleet: FleetOf) -> list[str]:
    return [fleet.settings.standby.listen] if fleet.settings.standby.peer else []


def _nothing_shared(path: Path | None, key: str, fleets: list[FleetOf], of: Callable[[FleetOf], list[str]]) -> None:
    seen: dict[str, str] = {}
    for fleet in fleets:
        for value in of(fleet):
            if value in seen:
                raise ConfigError(f"{path}: {key}: {value} is given to {seen[value]} and to {fleet.name}; each needs its own")
            seen[value] = f"fleet {fleet.name}"
