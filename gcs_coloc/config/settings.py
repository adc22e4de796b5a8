"""Settings of the service, read from a TOML file, environment variables and flags.

Flags win over the environment (`GCS_COLOC_...`, nested keys joined by two underscores), which wins over the file.
The settings are frozen. An unknown key is refused.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from types import MappingProxyType
from typing import Any

from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsConfigDict, SettingsError

from gcs_coloc.config.sections import (
    AidingConfig,
    EstimatorConfig,
    FleetConfig,
    ForwardConfig,
    GpsHealthConfig,
    IntegrityConfig,
    MavlinkConfig,
    MeasurementConfig,
    SendersConfig,
    SigningConfig,
    StationConfig,
    TimeConfig,
)
from gcs_coloc.config.service_sections import (
    MqttConfig,
    RecordConfig,
    ServiceConfig,
    StandbyConfig,
    WebConfig,
)
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.errors import ConfigError

_ENVIRONMENT = "GCS_COLOC_"
_LEVEL = "__"
_VALUE_ERROR = "Value error, "
_FLAGS = {
    ("fleet", "failed"): "--failed",
    ("fleet", "healthy"): "--healthy",
    ("web", "address"): "--web",
    ("standby",): "--peer",
}
"""The flags that a wrong value may have come from, by the setting."""
RENAMED: Mapping[str, str] = MappingProxyType(
    {
        "aid": "aiding",
        "aid.way": "aiding.method",
        "aid.ways": "aiding.methods",
        "feed": "measurements",
        "feed.least_position_sigma_m": "measurements.min_position_sigma_m",
        "feed.oldest_s": "measurements.max_age_s",
        "fleet.most_vehicles": "fleet.max_vehicles",
        "health": "gps_health",
        "senders.roam_after_s": "senders.rebind_after_s",
        "time.least_delay_s": "time.min_delay_s",
        "time.least_delay_sigma_s": "time.min_delay_sigma_s",
    }
)
"""Key of 0.1 to key of 0.2; a section stands before its keys."""


class Settings(BaseSettings):
    """All that can be set for one fleet.

    Every key has a default but `links`: a service without a link has nothing to do.
    """

    model_config = SettingsConfigDict(extra="forbid", frozen=True, env_prefix=_ENVIRONMENT, env_nested_delimiter=_LEVEL)

    links: tuple[str, ...] = ()
    """Connection strings of the vehicles: `udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcp:HOST:PORT`, `tcpin:HOST:PORT`,
    `serial:DEVICE:BAUD`."""
    out: tuple[str, ...] = ()
    """Connection strings of ground tools that get the vehicles' frames: `udp:HOST:PORT`, `udpin:HOST:PORT`, `tcp:HOST:PORT`,
    `tcpin:HOST:PORT`, `serial:DEVICE:BAUD`."""
    mavlink: MavlinkConfig = Field(default_factory=lambda: MavlinkConfig.model_validate({}))
    signing: SigningConfig = Field(default_factory=lambda: SigningConfig.model_validate({}))
    senders: SendersConfig = Field(default_factory=lambda: SendersConfig.model_validate({}))
    forward: ForwardConfig = Field(default_factory=lambda: ForwardConfig.model_validate({}))
    fleet: FleetConfig = Field(default_factory=lambda: FleetConfig.model_validate({}))
    station: tuple[StationConfig, ...] = ()
    """Fixed stations, a table `[[station]]` for each."""
    estimator: EstimatorConfig = Field(default_factory=lambda: EstimatorConfig.model_validate({}))
    web: WebConfig = Field(default_factory=lambda: WebConfig.model_validate({}))
    record: RecordConfig = Field(default_factory=lambda: RecordConfig.model_validate({}))
    mqtt: MqttConfig = Field(default_factory=lambda: MqttConfig.model_validate({}))
    standby: StandbyConfig = Field(default_factory=lambda: StandbyConfig.model_validate({}))
    service: ServiceConfig = Field(default_factory=lambda: ServiceConfig.model_validate({}))
    gps_health: GpsHealthConfig = Field(default_factory=GpsHealthConfig)
    measurements: MeasurementConfig = Field(default_factory=MeasurementConfig)
    integrity: IntegrityConfig = Field(default_factory=IntegrityConfig)
    aiding: AidingConfig = Field(default_factory=AidingConfig)
    time: TimeConfig = Field(default_factory=TimeConfig)

    @field_validator("station")
    @classmethod
    def _one_station_each(cls, stations: tuple[StationConfig, ...]) -> tuple[StationConfig, ...]:
        for number, station in enumerate(stations):
            if station.id in [other.id for other in stations[:number]]:
                raise ValueError(f"two stations have id {station.id}; give each its own")
        return stations

    def engine(self) -> EngineSettings:
        """The part that the engine needs."""
        return EngineSettings(
            gps_health=self.gps_health,
            measurements=self.measurements,
            aiding=self.aiding,
            time=self.time,
            integrity=self.integrity,
            request_streams=self.fleet.request_streams,
            max_vehicles=self.fleet.max_vehicles,
            stations=tuple(station.station() for station in self.station),
            names=self.fleet.names,
        )

    def fingerprint(self) -> str:
        """Return 16 digits that stand for all that the engine's answers depend on.

        That is the estimator, its settings and `engine`, without the vehicles' names.
        """
        engine = asdict(self.engine())
        del engine["names"]
        all_of_it = {"estimator": self.estimator.model_dump(), "engine": engine}
        return hashlib.sha256(json.dumps(all_of_it, sort_keys=True, default=str).encode()).hexdigest()[:16]


def settings_of(tables: Sequence[Mapping[str, Any]], flags: Mapping[str, Any], source: str) -> Settings:
    """Return the settings of flags, environment and a file's tables.

    Flags win over the environment, and that over the tables, of which an earlier one wins over a later one.
    `source` names the tables in errors.

    Raises:
        ConfigError: a key is unknown, or a value impossible; the text names them.
    """

    class FromFile(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            del dotenv_settings, file_secret_settings
            from_file = (InitSettingsSource(settings_cls, init_kwargs=dict(table)) for table in tables)
            return init_settings, env_settings, *from_file

    _refuse_unknown_variables()
    try:
        settings = FromFile(**flags)
    except SettingsError as error:
        # Its own text names the field, its cause what is wrong with the JSON.
        raise ConfigError(
            f"environment variable {_ENVIRONMENT}...: {error}; lists and tables are JSON, as '[\"14550\"]'"
        ) from None
    except ValidationError as error:
        problems = [_flag_problem(e, flags) or (_variable_of(e, flags) or source, _problem(e)) for e in error.errors()]
        by_source = groupby(problems, key=lambda problem: problem[0])
        raise ConfigError("; ".join(f"{where}: {'; '.join(text for _, text in found)}" for where, found in by_source)) from None
    for table in tables:
        for key, value in _booleans_read_as_numbers(table, settings):
            raise ConfigError(f"{source}: {key}: must be a number, not {str(value).lower()}")
    return settings


def _booleans_read_as_numbers(value: Any, found: Any, key: str = "") -> Iterator[tuple[str, bool]]:
    """Yield what is true or false in the table, list or value of a key where the setting is no boolean.

    `found` are the settings made of it. To pydantic, as to Python, true is 1.
    """
    if isinstance(value, Mapping):
        for name, each in value.items():
            of_settings = found.get(name) if isinstance(found, Mapping) else getattr(found, name, None)
            yield from _booleans_read_as_numbers(each, of_settings, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for number, (each, of_settings) in enumerate(zip(value, found or (), strict=False)):
            yield from _booleans_read_as_numbers(each, of_settings, f"{key}.{number}")
    elif isinstance(value, bool) and not isinstance(found, bool):
        yield key, value


def _flag_problem(error: Any, flags: Mapping[str, Any]) -> tuple[str, str] | None:
    """The flag that a wrong value came from, and what is wrong with it; None where it came from elsewhere."""
    setting = next((each for each in _FLAGS if each == error["loc"][: len(each)]), None)
    if setting is None or not _set_by_flag(setting, flags):
        return None
    return _FLAGS[setting], _problem(error).removeprefix(".".join(str(part) for part in error["loc"]) + ": ")


def _set_by_flag(setting: tuple[Any, ...], flags: Mapping[str, Any]) -> bool:
    value: Any = flags
    for key in setting:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value is not None


def _variable_of(error: Any, flags: Mapping[str, Any]) -> str | None:
    """Return the environment variable that a setting has its value from.

    None where the value comes from a flag or the file, or where the setting has none.
    """
    # A section that is checked as a whole names its setting by the first word of the text.
    place = (*error["loc"], *error["msg"].removeprefix(_VALUE_ERROR).split()[:1])
    if _set_by_flag(error["loc"], flags):
        return None
    names = {name.upper(): name for name in os.environ}
    wanted = (_ENVIRONMENT + _LEVEL.join(str(key) for key in place[:depth]).upper() for depth in range(len(place), 0, -1))
    found = next((names[name] for name in wanted if name in names), None)
    return f"environment variable {found}" if found is not None else None


def _refuse_unknown_variables() -> None:
    """Raise ConfigError for an environment variable of a section that does not exist.

    pydantic-settings ignores such a variable. An unknown key in a section that exists is refused with the rest.
    """
    for name in sorted(os.environ):
        if not name.upper().startswith(_ENVIRONMENT):
            continue
        section = name[len(_ENVIRONMENT) :].lower().split(_LEVEL)[0]
        if (renamed := _new_name(section)) is not None:
            right = f"{_ENVIRONMENT}{renamed.upper()}{name[len(_ENVIRONMENT) + len(section) :]}"
            raise ConfigError(f"environment variable {name}: is called {right} since version 0.2")
        if section not in Settings.model_fields:
            raise ConfigError(f"environment variable {name}: there is no {section!r} to set; see the configuration reference")


def _problem(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        if (renamed := _new_name(key)) is not None or (renamed := _new_name(key.removeprefix("fleet."))) is not None:
            return f"{key}: is called {renamed} since version 0.2"
        return f"{key}: unknown key; see the configuration reference for those there are"
    if error["type"] == "tuple_type":
        is_table = isinstance(error["input"], Mapping)
        return (
            f"{key}: must be a table in double brackets, [[{key}]]" if is_table else f"{key}: must be a list, in brackets: [...]"
        )
    if error["type"] in ("dataclass_type", "model_type", "dict_type"):
        return f"{key}: must be a table of settings, [{key}]"
    text = error["msg"].removeprefix(_VALUE_ERROR)
    return f"{key}: {text[0].lower() + text[1:]}" if key else text


def _new_name(key: str) -> str | None:
    """Return the name since 0.2 of a key that 0.2 refuses; None where 0.1 had no such key.

    A key of 0.1 whose section has the new name already is found too.
    """
    return RENAMED.get(key) or _HALF_RENAMED.get(key)


def _with_new_section(key: str) -> str:
    section, _, rest = key.partition(".")
    return f"{RENAMED.get(section, section)}.{rest}"


_HALF_RENAMED = {_with_new_section(old): new for old, new in RENAMED.items() if "." in old}
