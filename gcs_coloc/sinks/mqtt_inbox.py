"""Inbox of commands and ranges over MQTT, each only where the settings allow it.

Refusals are counted by reason.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, Override, PrimaryOverride
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, MAX_SYSTEM_ID, station_node
from gcs_coloc.mavlink.checks import RANGE_MAX_M, UNIX_TIME_FROM_US, UNIX_TIME_TO_US
from gcs_coloc.mavlink.refusals import Counts

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


_MAX_PAYLOAD_BYTES = 1000
"""Chosen: five times the longest valid message; a longer one is not parsed."""


class MqttRefusal(StrEnum):
    """Why an MQTT message was refused. Its value is the `reason` label of the metric."""

    TOPIC_NOT_ALLOWED = "mqtt_topic_not_allowed"
    """Commands or ranges are not switched on."""
    COMMAND_RETAINED = "mqtt_cmd_retained"
    """A retained command would be applied anew with every reconnection, long after it was meant."""
    COMMAND_TOO_LONG = "mqtt_cmd_too_long"
    COMMAND_OF_UNKNOWN_VEHICLE = "mqtt_cmd_of_unknown_vehicle"
    COMMAND_INVALID = "mqtt_cmd_invalid"
    COMMAND_TO_STANDBY = "mqtt_cmd_to_standby"
    """An override for the service of a hot standby that follows: the active one has those of both."""
    ORDER_REFUSED = "mqtt_standby_order_refused"
    """An order on a hot standby that cannot be carried out now, or where there is none."""
    RANGE_RETAINED = "mqtt_range_retained"
    """A retained range is old."""
    RANGE_TOO_LONG = "mqtt_range_too_long"
    RANGE_OF_UNKNOWN_VEHICLE = "mqtt_range_of_unknown_vehicle"
    RANGE_INVALID = "mqtt_range_invalid"
    RANGE_TO_ITSELF = "mqtt_range_to_itself"


@dataclass(frozen=True, slots=True)
class MqttHooks:
    """What the MQTT side may request of the service.

    `snapshot` is the fleet as it stands, `known_sysids` the system ids heard so far, `apply_command` applies an operator's
    override, `add_range` adds a range; `clock` is the service's, in seconds. `command_refusal` says why overrides are not to be
    given to this service, `order_standby` carries out an order on the hot standby, where there is one, and says why not.
    `alarms` brings the alarms up to date with a snapshot and returns those in the list.
    """

    snapshot: Callable[[], FleetSnapshot]
    known_sysids: Callable[[], Collection[int]]
    apply_command: Callable[[int, Override], None]
    add_range: Callable[[PeerRange], None]
    clock: Callable[[], float]
    command_refusal: Callable[[], str | None] = lambda: None
    order_standby: Callable[[StandbyOrder], str | None] | None = None
    alarms: Callable[[FleetSnapshot], Iterable[Alarm]] = lambda _: ()


class MqttInbox:
    """Receives messages below `base`, a topic; counts refusals into `counts`."""

    def __init__(self, base: str, hooks: MqttHooks, counts: Counts, *, commands: bool, ranges: bool) -> None:
        self._base = base
        self._hooks = hooks
        self._counts = counts
        self._allowed = [name for name, allowed in (("cmd", commands), ("range", ranges)) if allowed]

    @property
    def topics(self) -> list[str]:
        """The topics to subscribe to; none where nothing is allowed."""
        return [f"{self._base}/+/{name}" for name in self._allowed]

    def receive(self, topic: str, payload: bytes, *, retained: bool) -> None:
        """Apply one message, or count why it is refused. Never raises for its content."""
        try:
            refusal = self._apply(topic, payload, retained)
        except ValidationError:
            refusal = MqttRefusal.RANGE_INVALID if topic.endswith("/range") else MqttRefusal.COMMAND_INVALID
        if refusal is not None:
            self._counts.add(refusal)

    def _apply(self, topic: str, payload: bytes, retained: bool) -> MqttRefusal | None:
        sysid_text, _, name = topic.removeprefix(f"{self._base}/").partition("/")
        if name not in self._allowed:
            return MqttRefusal.TOPIC_NOT_ALLOWED
        is_command = name == "cmd"
        if retained:
            return MqttRefusal.COMMAND_RETAINED if is_command else MqttRefusal.RANGE_RETAINED
        if len(payload) > _MAX_PAYLOAD_BYTES:
            return MqttRefusal.COMMAND_TOO_LONG if is_command else MqttRefusal.RANGE_TOO_LONG
        if is_command and sysid_text == "standby":
            return self._order(payload)
        sysid = int(sysid_text) if sysid_text.isascii() and sysid_text.isdigit() and len(sysid_text) <= 3 else None
        if sysid is None or sysid not in self._hooks.known_sysids():
            return MqttRefusal.COMMAND_OF_UNKNOWN_VEHICLE if is_command else MqttRefusal.RANGE_OF_UNKNOWN_VEHICLE
        return self._apply_command(sysid, payload) if is_command else self._add_range(sysid, payload)

    def _apply_command(self, sysid: int, payload: bytes) -> MqttRefusal | None:
        command = Command.model_validate_json(payload)
        if self._hooks.command_refusal() is not None:
            return MqttRefusal.COMMAND_TO_STANDBY
        self._hooks.apply_command(sysid, command.override())
        return None

    def _order(self, payload: bytes) -> MqttRefusal | None:
        command = StandbyCommand.model_validate_json(payload)
        order = self._hooks.order_standby
        return MqttRefusal.ORDER_REFUSED if order is None or order(command.order) is not None else None

    def _add_range(self, sysid: int, payload: bytes) -> MqttRefusal | None:
        measured = Range.model_validate_json(payload)
        if measured.peer == sysid:
            return MqttRefusal.RANGE_TO_ITSELF
        self._hooks.add_range(measured.message(sysid, self._hooks.clock()))
        return None
