"""Configuration: a TOML file, environment variables and command-line flags become frozen settings; unknown keys are refused.

Flags win over the environment (`GCS_COLOC_...`, nested keys joined by two underscores), which wins over the file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsConfigDict

from gcs_coloc.config_sections import (
    AidConfig,
    EstimatorConfig,
    FeedConfig,
    FleetConfig,
    ForwardConfig,
    HealthConfig,
    MavlinkConfig,
    MqttConfig,
    RecordConfig,
    SendersConfig,
    SigningConfig,
    TimeConfig,
    WebConfig,
)
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.errors import ConfigError


class Settings(BaseSettings):
    """All that can be set for one fleet. Every key has a default but `links`: a service without a link has nothing to do."""

    model_config = SettingsConfigDict(extra="forbid", frozen=True, env_prefix="GCS_COLOC_", env_nested_delimiter="__")

    links: tuple[str, ...] = Field(
        (), description="connection strings: udpin:HOST:PORT, udpout:, tcp:, tcpin:, serial:DEVICE:BAUD"
    )
    out: tuple[str, ...] = Field(
        (), description="ground tools to hand the vehicles' frames on to: HOST:PORT, udp:, udpin:, tcp:, tcpin:, serial:"
    )
    mavlink: MavlinkConfig = Field(default_factory=lambda: MavlinkConfig.model_validate({}))
    signing: SigningConfig = Field(default_factory=lambda: SigningConfig.model_validate({}))
    senders: SendersConfig = Field(default_factory=lambda: SendersConfig.model_validate({}))
    forward: ForwardConfig = Field(default_factory=lambda: ForwardConfig.model_validate({}))
    fleet: FleetConfig = Field(default_factory=lambda: FleetConfig.model_validate({}))
    estimator: EstimatorConfig = Field(default_factory=lambda: EstimatorConfig.model_validate({}))
    web: WebConfig = Field(default_factory=lambda: WebConfig.model_validate({}))
    record: RecordConfig = Field(default_factory=lambda: RecordConfig.model_validate({}))
    mqtt: MqttConfig = Field(default_factory=lambda: MqttConfig.model_validate({}))
    health: HealthConfig = Field(default_factory=HealthConfig)
    feed: FeedConfig = Field(default_factory=FeedConfig)
    aid: AidConfig = Field(default_factory=AidConfig)
    time: TimeConfig = Field(default_factory=TimeConfig)

    def engine(self) -> EngineSettings:
        """The part that the engine needs."""
        return EngineSettings(
            health=self.health,
            feed=self.feed,
            aid=self.aid,
            time=self.time,
            request_streams=self.fleet.request_streams,
            most_vehicles=self.fleet.most_vehicles,
        )


def read_table(path: Path) -> dict[str, Any]:
    """The table in a TOML file.

    Raises:
        ConfigError: the file cannot be read or parsed.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}") from None


def settings_of(table: Mapping[str, Any], flags: Mapping[str, Any], source: str) -> Settings:
    """Settings from the flags, then the environment, then a file's table; `source` is named in errors.

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
            return init_settings, env_settings, InitSettingsSource(settings_cls, init_kwargs=dict(table))

    try:
        return FromFile(**flags)
    except ValidationError as error:
        raise ConfigError(f"{source}: {'; '.join(_problem(e) for e in error.errors())}") from None


def _problem(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key}: unknown key; see the configuration reference for those there are"
    text = error["msg"].removeprefix("Value error, ")
    return f"{key}: {text[0].lower() + text[1:]}" if key else text
