"""`[[fleet]]`: several fleets in one service, each with settings of its own.

What stands outside the fleets' tables holds for all of them; what a fleet's table says goes before it. Nothing is shared but
the process, if that: where two fleets would share a link, a page or a name, the configuration is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from operator import eq
from pathlib import Path
from typing import Any, TypeVar

from gcs_coloc.config.service_sections import topic_level
from gcs_coloc.config.settings import Settings, settings_of
from gcs_coloc.core.errors import ConfigError, GcsColocError, UsageError
from gcs_coloc.links.base import LinkAddress, parse, parse_out
from gcs_coloc.runtime.checked_tables import read_toml

Value = TypeVar("Value")

PER_FLEET = "per-fleet"
"""Of `processes` in `[service]`: a process for each fleet."""
_ANY_FREE = "127.0.0.1:0"
_SECTIONS = frozenset(Settings.model_fields) - {"fleet", "service"}
_FLAGS_OF_ONE = {
    "links": "--udp and --link",
    "out": "--out",
    "fleet": "--failed and --healthy",
    "web": "--web",
    "standby": "--peer and --standby",
}


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Begin the text of every error that is raised within with `fleet NAME`.

    The text stays as it is where `name` is empty.
    """
    try:
        yield
    except GcsColocError as error:
        if not name:
            raise
        raise type(error)(f"fleet {name}: {error}") from None


@dataclass(frozen=True, slots=True)
class FleetOf:
    """One fleet of a service; `name` is empty where it is the only one and needs none.

    `flagged` are the keys of its `[fleet]` that flags have set.
    """

    name: str
    settings: Settings
    flagged: frozenset[str] = frozenset()

    def named(self) -> AbstractContextManager[None]:
        """Begin the text of every error that is raised within with this fleet's name, if it has one."""
        return naming(self.name)


def load_fleets(
    path: Path | None, flags: Mapping[str, Any], fleet: str | None = None, *, is_checked: bool = False
) -> Sequence[FleetOf]:
    """Return the fleets of a configuration, in its order.

    They are those of its `[[fleet]]` tables, or the one called `fleet`. A configuration without such tables has one fleet.
    `is_checked`: all fleets were right once, and `fleet` must start whatever was made of the others' tables since.

    Raises:
        ConfigError: the file cannot be read, or a key or value is wrong, or two fleets share what each must have for itself.
        UsageError: a flag says something of one fleet where there are several, or there is no fleet of that name.
    """
    table = read_toml(path, ConfigError) if path is not None else {}
    flagged = frozenset(flags.get("fleet", ()))
    if not isinstance(table.get("fleet"), list):
        if fleet is not None:
            raise UsageError(f"--fleet {fleet}: {f'{path} has no [[fleet]]' if path else 'there is no --config'}: leave it out")
        settings = settings_of([table], flags, str(path) if path is not None else "settings")
        if settings.service.processes == PER_FLEET:
            raise ConfigError(f"{path or 'settings'}: service.processes: {PER_FLEET} needs a table [[fleet]] for each fleet")
        return [FleetOf("", settings, flagged)]
    if fleet is not None:
        if not is_checked:
            _several(path, table, {})  # all of them are read for what is wrong with any; the flags are for the one
        names = [own.get("name") if isinstance(own, dict) else None for own in table["fleet"]]
        if fleet not in names:
            raise UsageError(f"--fleet {fleet}: {path} has no such fleet, but {', '.join(map(str, filter(None, names)))}")
        number = names.index(fleet)
        return [replace(_fleet(path, number + 1, table, table["fleet"][number], flags), flagged=flagged)]
    for key, option in _FLAGS_OF_ONE.items():
        if key in flags and flags[key] != {"on": False}:
            raise UsageError(f"{option}: {path} is of several fleets ([[fleet]]); say it in the table of the fleet that is meant")
    return _several(path, table, flags)


def load_settings(path: Path | None, flags: Mapping[str, Any], fleet: str | None = None) -> Settings:
    """Return the settings of one fleet.

    It is the one called `fleet` where the configuration is of several, else the only one.

    Raises:
        ConfigError: as `load_fleets`.
        UsageError: the configuration is of several fleets and none is named, or has none of that name.
    """
    table = read_toml(path, ConfigError) if path is not None else {}
    if fleet is None and isinstance(table.get("fleet"), list):
        names = [each.name for each in _several(path, table, {})]
        raise UsageError(f"{path}: is of several fleets ([[fleet]]): say which with --fleet: {', '.join(names)}")
    (one,) = load_fleets(path, flags, fleet)
    return one.settings


def _several(path: Path | None, table: Mapping[str, Any], flags: Mapping[str, Any]) -> Sequence[FleetOf]:
    if not table["fleet"]:
        raise ConfigError(f"{path}: fleet: there is none in the list; begin each fleet with [[fleet]]")
    for key in ("links", "out"):
        if key in table:
            raise ConfigError(f"{path}: {key}: of which fleet? Each [[fleet]] has {key} of its own")
    fleets = [_fleet(path, number, table, own, flags) for number, own in enumerate(table["fleet"], 1)]
    _nothing_shared(path, "name", fleets, lambda fleet: [fleet.name])
    _nothing_shared(path, "links", fleets, _links, lambda one, other: one.is_same_place(other))
    _nothing_shared(path, "out", fleets, _outs, lambda one, other: one.is_same_place(other))
    for one, other in permutations(fleets, 2):
        for out, link in product(_outs(one), _links(other)):
            if out.leads_to(link):
                raise ConfigError(
                    f"{path}: out: {out} of fleet {one.name} leads to the vehicles' link {link} of fleet {other.name}; "
                    "give the address where the ground tool is"
                )
    _nothing_shared(path, "web.address", fleets, _fixed_address)
    _nothing_shared(path, "standby.listen", fleets, _standby_address)
    for fleet in fleets:
        service = fleet.settings.service
        if service.processes == PER_FLEET and fleet.settings.web.on and service.address in _fixed_address(fleet):
            raise ConfigError(
                f"{path}: service.address: {service.address}, of the page of all fleets, is given to fleet {fleet.name}; "
                "each needs its own"
            )
    return fleets


def _fleet(path: Path | None, number: int, common: Mapping[str, Any], own: object, flags: Mapping[str, Any]) -> FleetOf:
    source = f"{path}: fleet {number}"
    if not isinstance(own, Mapping):
        raise ConfigError(f"{source}: is no table; begin each fleet with [[fleet]]")
    own = dict(own)
    name = own.pop("name", None)
    if not isinstance(name, str):
        raise ConfigError(f'{source}: name: each [[fleet]] needs one, as name = "north"')
    try:
        topic_level(name)  # it is a directory and a word in the log as well
    except ValueError as error:
        raise ConfigError(f"{source}: name: {error}") from None
    source = f"{source} ({name})"
    if "service" in own:
        raise ConfigError(f"{source}: service: is of all fleets; put [service] before the first [[fleet]]")
    sections = {key: own.pop(key) for key in _SECTIONS & own.keys()}
    shared = {key: value for key, value in common.items() if key != "fleet"}
    settings = settings_of([sections | {"fleet": own}, shared], flags, source)
    if not settings.links:
        raise ConfigError(f"{source}: links: there is none to listen on")
    if "fleet" in settings.mqtt.model_fields_set:
        raise ConfigError(f"{source}: mqtt.fleet: the fleet's name stands in the topics; leave it out")
    record, web = settings.record, settings.web
    page: dict[str, Any] = {"on": web.on and web.must_open}
    if web.on and not web.must_open and settings.service.processes == PER_FLEET:
        page = {"address": _ANY_FREE}  # the page of all fleets leads there
    return FleetOf(
        name,
        settings.model_copy(
            update={
                "mqtt": settings.mqtt.model_copy(update={"fleet": name}),
                "record": record.model_copy(update={"directory": str(Path(record.directory) / name) if record.directory else ""}),
                "web": web.model_copy(update=page),
            }
        ),
    )


def _links(fleet: FleetOf) -> list[LinkAddress]:
    return [parse(link) for link in fleet.settings.links]


def _outs(fleet: FleetOf) -> list[LinkAddress]:
    return [parse_out(out) for out in fleet.settings.out]


def _fixed_address(fleet: FleetOf) -> list[str]:
    web = fleet.settings.web
    return [web.address] if web.on and web.host_and_port()[1] != 0 else []


def _standby_address(fleet: FleetOf) -> list[str]:
    return [fleet.settings.standby.listen] if fleet.settings.standby.peer else []


def _nothing_shared(
    path: Path | None,
    key: str,
    fleets: list[FleetOf],
    of: Callable[[FleetOf], list[Value]],
    is_same: Callable[[Value, Value], bool] = eq,
) -> None:
    for one, other in combinations(fleets, 2):
        for its, others in product(of(one), of(other)):
            if is_same(its, others):
                what = f"{its} is" if its == others else f"{its} and {others} are the same place,"
                raise ConfigError(f"{path}: {key}: {what} given to fleet {one.name} and to {other.name}; each needs its own")
