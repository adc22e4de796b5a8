"""The sections of the configuration: each a table of its own in the file, with what it takes and what it refuses."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.gps_health.gps_health import GpsHealthSettings
from gcs_coloc.core.telemetry.measurement_builder import MeasurementSettings

_STRICT = ConfigDict(extra="forbid")
_MAY_BE_ZERO = ("lag_s", "gps_id", "min_delay_s", "regain_after_s", "hand_back_s", "ek3_gps_check")


_LIMITS = {
    "rate_hz": (1.0, 50.0),
    "external_rate_hz": (0.1, 10.0),
    "lag_s": (0.0, 1.0),
    "gps_id": (0, 1),
    "timesync_period_s": (0.1, 60.0),
}
"""Beyond these a value is a slip, such as milliseconds for seconds, that floods a link or reaches no receiver of the vehicle."""


class _Checked:
    """Refuses numbers that no setting of the core can mean: negative, zero where a duration or sigma is meant, not finite."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                continue
            least_ok = value >= 0 if f.name in _MAY_BE_ZERO else value > 0
            if not (math.isfinite(value) and least_ok):
                raise ValueError(f"{f.name} must be a positive number, not {value}")
            least, most = _LIMITS.get(f.name, (0, math.inf))
            if not least <= value <= most:
                raise ValueError(f"{f.name} must be from {least:g} to {most:g}, not {value:g}")


@dataclass(frozen=True, config=_STRICT)
class GpsHealthConfig(_Checked, GpsHealthSettings):
    """`[gps_health]`: when a vehicle's GPS is taken to have failed, and to be back."""


@dataclass(frozen=True, config=_STRICT)
class MeasurementConfig(_Checked, MeasurementSettings):
    """`[measurements]`: noise that the wire does not tell."""


@dataclass(frozen=True, config=_STRICT)
class AidingConfig(_Checked, AidingSettings):
    """`[aiding]`: what is sent to a vehicle without GPS."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for sysid in self.methods:
            if not 1 <= sysid <= 255:
                raise ValueError(f"methods: {sysid} is not a MAVLink system id (1 to 255)")


@dataclass(frozen=True, config=_STRICT)
class TimeConfig(_Checked, TimeSettings):
    """`[time]`: whose clock says what."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class MavlinkConfig(_Section):
    """`[mavlink]`: who we are on the link."""

    system_id: int = Field(254, ge=1, le=255, description="our MAVLink system id; a vehicle may demand its MAV_GCS_SYSID here")
    component_id: int = Field(191, ge=1, le=255, description="our MAVLink component id (MAV_COMP_ID_ONBOARD_COMPUTER)")


SigningMode = Literal["require", "accept", "off"]


class SigningConfig(_Section):
    """`[signing]`: MAVLink 2 signatures. A key that no link uses, and a link that wants a key where none is set, are errors."""

    key_file: str = Field("", description="the file of the secret key, its mode 0600; empty: no signing")
    mode: SigningMode = Field("off", description="require: unsigned frames are refused; accept: they are taken; off: no signing")
    links: dict[str, SigningMode] = Field(default_factory=dict, description="the mode of single links, by connection string")

    @model_validator(mode="after")
    def _key_and_mode_agree(self) -> Self:
        signs = any(mode != "off" for mode in (self.mode, *self.links.values()))
        if signs and not self.key_file:
            raise ValueError("links are to be signed, but no key_file is set")
        if self.key_file and not signs:
            raise ValueError('a key_file is set, but the mode is off on every link; set mode = "require"')
        return self


class SendersConfig(_Section):
    """`[senders]`: who may speak for a vehicle, and how much anybody may say."""

    rebind_after_s: float = Field(
        5.0, gt=0, description="a vehicle that was silent for so long may turn up at another address; inf: never"
    )
    companions_elsewhere: bool = Field(
        False, description="components other than the autopilot may use a vehicle's system id from addresses of their own"
    )
    bytes_per_s: float = Field(
        200_000.0, ge=10_000, allow_inf_nan=False, description="what a vehicle's address, or all others, send beyond is dropped"
    )


class ForwardConfig(_Section):
    """`[forward]`: what the ground tools behind `out` are shown besides what the vehicles send."""

    echo_gps_input: bool = Field(False, description="the GPS_INPUT that we send is shown to the ground tools, too")


class FleetConfig(_Section):
    """`[fleet]`: the operator's word on single vehicles, and the fleet's bounds."""

    failed: tuple[int, ...] = Field((), description="system ids whose GPS is declared failed, whatever it says")
    healthy: tuple[int, ...] = Field((), description="system ids whose GPS is declared healthy, whatever it says")
    max_vehicles: int = Field(250, ge=2, le=250, description="vehicles beyond this number are refused")
    request_streams: bool = Field(True, description="ask vehicles for the messages that are missing (SET_MESSAGE_INTERVAL)")

    @field_validator("failed", "healthy")
    @classmethod
    def _sysids(cls, sysids: tuple[int, ...]) -> tuple[int, ...]:
        for sysid in sysids:
            if not 1 <= sysid <= 255:
                raise ValueError(f"{sysid} is not a MAVLink system id (1 to 255)")
        return sysids

    @model_validator(mode="after")
    def _one_word_each(self) -> FleetConfig:
        both = sorted({*self.failed} & {*self.healthy})
        if both:
            raise ValueError(f"vehicle {both[0]} is declared failed and healthy; declare it one of the two")
        return self


class EstimatorConfig(_Section):
    """`[estimator]`: which estimator locates the vehicles, with its own settings in `[estimator.settings]`."""

    name: str = Field("fleet", description="fleet, qu_zhang, or a plug-in as package.module:Class or path/to/file.py:Class")
    settings: dict[str, Any] = Field(default_factory=dict, description="settings of that estimator")


class WebConfig(_Section):
    """`[web]`: the live page, the metrics and the operator's commands."""

    on: bool = Field(True, description="serve the page")
    address: str = Field("127.0.0.1:8080", description="HOST:PORT to listen on; port 0 takes any that is free")
    allowed_hosts: tuple[str, ...] = Field(
        (), description="names besides IP addresses and localhost that the page may be called by"
    )
    token_file: str = Field("", description="file with the operator's token; without one the page is read-only")
    tiles: str = Field("", description="a PMTiles file of raster tiles to draw under the map; empty: none")

    @field_validator("address")
    @classmethod
    def _address(cls, address: str) -> str:
        host, _, port = address.rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
            raise ValueError(f"{address} is not HOST:PORT, as 127.0.0.1:8080")
        return address

    @property
    def must_open(self) -> bool:
        """Whether the address was asked for: a service without its page is then not what the operator wanted."""
        return "address" in self.model_fields_set

    def host_and_port(self) -> tuple[str, int]:
        """The address in its parts, an IPv6 host without its brackets."""
        host, _, port = self.address.rpartition(":")
        return host.removeprefix("[").removesuffix("]"), int(port)


class RecordConfig(_Section):
    """`[record]`: recording the flight."""

    directory: str = Field("", description="where recordings are written; none are where it is empty")
    rotate_mb: int = Field(500, ge=1, le=100_000, description="a new pair of files is begun at this size, in megabytes")


def topic_level(text: str) -> str:
    """The text, if it can be one level of an MQTT topic. Raises ValueError where it cannot."""
    if not text or not all(c.isascii() and (c.isalnum() or c in "-_.") for c in text):
        raise ValueError(f"{text!r} is no part of a topic: letters, digits, -, _ and . only")
    return text


class MqttConfig(_Section):
    """`[mqtt]`: the fleet on an MQTT broker. Off while no host is set."""

    host: str = Field("", description="the broker's name or address; empty: no MQTT")
    port: int = Field(1883, ge=1, le=65535, description="the broker's port; 8883 is usual with TLS")
    tls: bool = Field(False, description="encrypt, and check the broker's certificate and name")
    ca_file: str = Field("", description="certificates (PEM) to check the broker's by; empty: the system's")
    username: str = Field("", description="the user; empty: none")
    password_file: str = Field("", description="the file of the user's password")
    prefix: str = Field("gcs-coloc", description="the beginning of every topic")
    fleet: str = Field("fleet", description="this fleet's name in the topics")
    publish_hz: float = Field(1.0, gt=0, le=5, description="how often each topic is published at most")
    commands: bool = Field(False, description="take the operator's word from the cmd topics")
    ranges: bool = Field(False, description="take ranges from the range topics")

    _topic_levels = field_validator("prefix", "fleet")(topic_level)

    @model_validator(mode="after")
    def _user_and_password_agree(self) -> Self:
        if self.password_file and not self.username:
            raise ValueError("a password_file is set, but no username")
        if self.ca_file and not self.tls:
            raise ValueError("a ca_file is set, but tls is false: nothing would be encrypted")
        if not self.host and (self.commands or self.ranges):
            raise ValueError("commands or ranges are to be taken, but no host is set: there is no broker to take them from")
        return self
