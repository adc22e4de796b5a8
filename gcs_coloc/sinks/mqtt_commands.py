"""MQTT commands and ranges, the messages that are received, as models.

docs/reference/mqtt.md describes every topic and field.
"""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, Override, PrimaryOverride
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, MAX_SYSTEM_ID, station_node
from gcs_coloc.mavlink.checks import RANGE_MAX_M, UNIX_TIME_FROM_US, UNIX_TIME_TO_US

_UNIX_FROM_S, _UNIX_TO_S = UNIX_TIME_FROM_US / 1e6, UNIX_TIME_TO_US / 1e6


class Command(BaseModel):
    """`…/{sysid}/cmd`: one override of the operator for a vehicle.

    It is of the vehicle's GPS state, of its aiding, or of its GPS_PRIMARY.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    gps: GpsOverride | None = None
    aiding: AidingOverride | None = None
    gps_primary: PrimaryOverride | None = None

    @model_validator(mode="after")
    def _one_override(self) -> Self:
        if len(self._overrides()) != 1:
            raise ValueError("one override is wanted")
        return self

    def override(self) -> Override:
        """Return the override of this command."""
        return self._overrides()[0]

    def _overrides(self) -> list[Override]:
        return [override for override in (self.gps, self.aiding, self.gps_primary) if override is not None]


class StandbyCommand(BaseModel):
    """`…/standby/cmd`: the operator's order on the hot standby."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    order: StandbyOrder


class Range(BaseModel):
    """`…/{sysid}/range`: a range that this vehicle measured to a vehicle (`peer`) or a station.

    It was measured at `unix_s` or `boot_s`; without both, on arrival.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    peer: int | None = Field(None, ge=1, le=MAX_SYSTEM_ID)
    station: int | None = Field(None, ge=0, le=MAX_STATION_ID)
    range_m: float = Field(gt=0.0, le=RANGE_MAX_M)
    sigma_m: float | None = Field(None, gt=0.0, le=RANGE_MAX_M)
    unix_s: float | None = Field(None, ge=_UNIX_FROM_S, le=_UNIX_TO_S)
    boot_s: float | None = Field(None, ge=0.0, lt=_UNIX_FROM_S)
    sequence: int | None = Field(None, ge=0)
    line_of_sight: float | None = Field(None, ge=0.0, le=1.0)
    device_id: int = Field(0, ge=0, le=255)

    @model_validator(mode="after")
    def _one_other_end(self) -> Self:
        if (self.peer is None) == (self.station is None):
            raise ValueError("a peer or a station is wanted")
        return self

    @property
    def node(self) -> int:
        """The node id of the other end."""
        return self.peer if self.peer is not None else station_node(self.station or 0)

    @model_validator(mode="after")
    def _one_clock(self) -> Self:
        if self.unix_s is not None and self.boot_s is not None:
            raise ValueError("unix_s and boot_s exclude each other")
        return self

    def message(self, sysid: int, received_at_s: float) -> PeerRange:
        """The range as the engine receives it: measured by vehicle `sysid`, received at a service time in s."""
        measured_at_s, base = self.boot_s, TimeBase.BOOT
        if self.unix_s is not None:
            measured_at_s, base = self.unix_s, TimeBase.UNIX
        elif self.boot_s is None:
            base = TimeBase.SERVICE
        return PeerRange(
            sysid=sysid,
            received_at_s=received_at_s,
            peer=self.node,
            range_m=self.range_m,
            sigma_m=self.sigma_m,
            measured_at_s=measured_at_s,
            time_base=base,
            sequence=self.sequence,
            line_of_sight=self.line_of_sight,
            device_id=self.device_id,
        )
