"""Sections of the configuration about vehicles, links and estimation, one class a table."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.gps_health.gps_health import GpsHealthSettings
from gcs_coloc.core.integrity.protection_level import ProtectionSettings
from gcs_coloc.core.stations.node_id import LARGEST_READ_SYSTEM_ID, MAX_STATION_ID
from gcs_coloc.core.stations.stations import (
    LEAST_STATION_SIGMA_M,
    MOST_STATION_SIGMA_M,
    STATION_SIGMA_M,
    Station,
    StationPosition,
)
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.mavlink.checks import ALTITUDE_MAX_M, ALTITUDE_MIN_M

_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class GpsHealthConfig(GpsHealthSettings):
    """`[gps_health]`: when a vehicle's GPS counts as failed, and as healthy again."""


@dataclass(frozen=True, config=_STRICT)
class MeasurementConfig(MeasurementSettings):
    """`[measurements]`: noise of what is measured, and how old a message may be.

    It is the noise that no message states, 1-sigma per axis.
    """


@dataclass(frozen=True, config=_STRICT)
class IntegrityConfig(ProtectionSettings):
    """`[integrity]`: the risk that an error exceeds its protection level, and how often what goes wrong."""


@dataclass(frozen=True, config=_STRICT)
class AidingConfig(AidingSettings):
    """`[aiding]`: what is sent to a GNSS-denied vehicle."""


@dataclass(frozen=True, config=_STRICT)
class TimeConfig(TimeSettings):
    """`[time]`: how the vehicles' clocks are brought to ours."""


class Section(BaseModel):
    """A table of the file; a key that it does not have is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class MavlinkConfig(Section):
    """`[mavlink]`: our own MAVLink ids."""

    system_id: int = Field(254, ge=1, le=255)
    """Our MAVLink system id. A vehicle with MAV_OPTIONS=1 takes GPS_INPUT only from its MAV_GCS_SYSID (255)."""
    component_id: int = Field(191, ge=1, le=255)
    """Our MAVLink component id; 191 is MAV_COMP_ID_ONBOARD_COMPUTER."""

    @property
    def own(self) -> tuple[int, int]:
        """Both ids."""
        return self.system_id, self.component_id


SigningMode = Literal["require", "accept", "off"]


class SigningConfig(Section):
    """`[signing]`: MAVLink 2 signatures.

    A key that no link uses is an error, as is a link to be signed where no key is set.
    """

    key_file: str = ""
    """File of the secret key, mode 0600: 64 hexadecimal digits; a passphrase on one line, whose SHA-256 is the key;
    or the 32 bytes. Empty: no signing."""
    mode: SigningMode = "off"
    """`require`: unsigned frames are refused; `accept`: they are accepted, but a wrong signature is refused;
    `off`: signatures are neither checked nor made. With `require` and `accept` all that is sent is signed."""
    links: dict[str, SigningMode] = Field(default_factory=dict)
    """A table `[signing.links]` with the mode of single links, by connection string:
    `"serial:/dev/ttyUSB0:57600" = "accept"`."""

    @model_validator(mode="after")
    def _key_and_mode_agree(self) -> Self:
        signs = any(mode != "off" for mode in (self.mode, *self.links.values()))
        if signs and not self.key_file:
            raise ValueError("links are to be signed, but no key_file is set")
        if self.key_file and not signs:
            raise ValueError('a key_file is set, but the mode is off on every link; set mode = "require"')
        return self


class SendersConfig(Section):
    """`[senders]`: who may send as a vehicle, and how much each sender may send."""

    rebind_after_s: float = Field(5.0, gt=0)
    """A system id is bound to the address that it is heard from. After so long a silence it may use another one.
    `inf`: never. Chosen: longer than a link drops out, shorter than a radio takes to be replaced."""
    companions_elsewhere: bool = False
    """Components other than the autopilot may use the vehicle's system id from addresses of their own;
    otherwise they are refused there."""
    bytes_per_s: float = Field(200_000.0, ge=10_000, allow_inf_nan=False)
    """A vehicle's address may send so much; the rest is dropped unread. All addresses without a vehicle share the same
    amount. A datagram counts as 64 bytes at least, and a quarter of a second's worth may come at once.
    Chosen: ten times what an autopilot sends on a fast link."""


class ForwardConfig(Section):
    """`[forward]`: what the ground tools behind `out` are shown besides what the vehicles send."""

    echo_gps_input: bool = False
    """The ground tools also get the GPS_INPUT that we send. They always get what the vehicles send."""
    alarms: bool = True
    """The ground tools are told of alarms (STATUSTEXT), and get our heartbeat."""


SysidsT = TypeVar("SysidsT", bound=Iterable[int])
VehicleName = Annotated[str, Field(min_length=1, max_length=9)]


class FleetConfig(Section):
    """`[fleet]`: the operator's settings of single vehicles, and the fleet's bounds."""

    failed: tuple[int, ...] = ()
    """System ids whose GPS is declared failed, whatever it says."""
    healthy: tuple[int, ...] = ()
    """System ids whose GPS is declared healthy, whatever it says."""
    max_vehicles: int = Field(250, ge=2, le=250)
    """More vehicles than this are refused. Chosen: what one-byte system ids leave beside ground stations."""
    request_streams: bool = True
    """Vehicles are asked for missing messages (MAV_CMD_SET_MESSAGE_INTERVAL)."""
    names: dict[int, VehicleName] = Field(default_factory=dict)
    """A table `[fleet.names]`: what people call a vehicle, by its system id, as `4 = "Kite"`; at most 9 characters, so that a
    line of the terminal's table holds them."""

    @field_validator("failed", "healthy", "names")
    @classmethod
    def _sysids(cls, sysids: SysidsT) -> SysidsT:
        for sysid in sysids:
            if not 1 <= sysid <= LARGEST_READ_SYSTEM_ID:
                raise ValueError(f"{sysid} is not a MAVLink system id (1 to {LARGEST_READ_SYSTEM_ID})")
        return sysids

    @model_validator(mode="after")
    def _one_word_each(self) -> FleetConfig:
        both = sorted({*self.failed} & {*self.healthy})
        if both:
            raise ValueError(f"vehicle {both[0]} is declared failed and healthy; declare it one of the two")
        return self


class StationConfig(Section):
    """`[[station]]`: one fixed station that vehicles range; a table for each."""

    id: int = Field(ge=0, le=MAX_STATION_ID)
    """The station's id, as the ranges name it: `peer_station` of PEER_RANGE, `beacon_id` of RANGING_BEACON, `STN3`.
    Stations and vehicles have ids of their own: station 3 is not vehicle 3."""
    name: str = Field("", max_length=40)
    """What people call it, on the page and in messages."""
    lat_deg: float = Field(ge=-90.0, le=90.0)
    """Latitude of its antenna, degrees, WGS 84."""
    lon_deg: float = Field(ge=-180.0, le=180.0)
    """Longitude of its antenna, degrees, WGS 84."""
    alt_m: float = Field(ge=ALTITUDE_MIN_M, le=ALTITUDE_MAX_M)
    """Altitude of its antenna above mean sea level, metres, by the datum of the vehicles' receivers."""
    sigma_m: float = Field(STATION_SIGMA_M, ge=LEAST_STATION_SIGMA_M, le=MOST_STATION_SIGMA_M)
    """1-sigma of that position on each axis, metres. It is taken as one error that lasts: no number of ranges averages it away.
    Chosen: a few minutes of a receiver without corrections."""
    range_bias_m: float = Field(0.0, ge=-1000.0, le=1000.0)
    """Lasting error of its ranging device, metres; from `gcs-coloc calibrate`. It adds to that of the vehicle's."""
    range_scale: float = Field(0.0, ge=-0.1, le=0.1)
    """Scale error of the same: the excess over 1."""

    def station(self) -> Station:
        """Return the station as the engine needs it."""
        position = StationPosition(self.lat_deg, self.lon_deg, self.alt_m, self.sigma_m, self.sigma_m)
        return Station(self.id, self.name, position, range_bias_m=self.range_bias_m, range_scale=self.range_scale)


class EstimatorConfig(Section):
    """`[estimator]`: which estimator locates the vehicles.

    Its own settings stand in `[estimator.settings]`.
    """

    name: str = "fleet"
    """`fleet`, `qu_zhang`, or a plug-in as `package.module:Class` or `path/to/file.py:Class`."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """A table `[estimator.settings]` with the estimator's own settings, see its page."""
