"""Findings of the checks with severity and remedy, and what a survey knows of the fleet: plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot, GpsReceiver
from gcs_coloc.core.readiness.vehicle_readiness import VehicleReadiness


class Severity(Enum):
    """Whether a finding is all right, works but is worth knowing, or would stop co-localisation."""

    RIGHT = "right"
    NOTE = "note"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Finding:
    """One conclusion of the doctor.

    `remedy`: what to do. `parameter`: the vehicle's parameter to set, and its value.
    """

    severity: Severity
    text: str
    remedy: str | None = None
    parameter: tuple[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Setup:
    """Our own set-up, against which the vehicles are checked.

    `system_id`: the id that we send under. `requires_synchronised_clock`: nothing is sent while this computer's clock is not
    synchronised. `denied`: the vehicles that are to be located; empty: all.
    """

    system_id: int = 254
    aiding: AidingSettings = field(default_factory=AidingSettings)
    requires_synchronised_clock: bool = False
    denied: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """One vehicle. Rates are those of the second half of the listening, by message id, Hz.

    `is_mavlink_1`: its autopilot sent no frame of MAVLink 2, though we did. `addresses`: where its autopilot was heard;
    `is_claimed_twice`: at more than one of them at the same time; `has_two_clocks`: its boot times are those of two autopilots
    in turn, wherever they are. `others_there`: other autopilots behind one of these addresses.
    `parameters`: those it told, by its own names; `parameter_kinds`: their MAV_PARAM_TYPE. `answers_only_to`: the system id
    under which it answered after it had not answered ours. `empty`: messages that came with impossible values only, such as a
    position of 0, 0. `peers`: the other ends of its ranges (node ids), whoever
    measured. `has_unstamped_ranges`: ranges that it measured came without a time stamp.
    `readiness`: whether it would be located if its GPS failed now; None where the listening was too short to tell, or no GPS is
    healthy. `utc_minus_host_s`: its clock's UTC against this computer's; None where it does not know UTC.
    """

    sysid: int
    autopilot: Autopilot
    armed: bool = False
    addresses: tuple[str, ...] = ()
    is_claimed_twice: bool = False
    has_two_clocks: bool = False
    others_there: tuple[int, ...] = ()
    is_signed: bool = False
    is_mavlink_1: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    parameter_kinds: Mapping[str, int] = field(default_factory=dict)
    answers_only_to: int | None = None
    rates_hz: Mapping[int, float] = field(default_factory=dict)
    empty: frozenset[int] = frozenset()
    receiver: GpsReceiver | None = None
    peers: frozenset[int] = frozenset()
    has_unstamped_ranges: bool = False
    answers_timesync: bool = False
    utc_minus_host_s: float | None = None
    readiness: VehicleReadiness | None = None


@dataclass(frozen=True, slots=True)
class FleetSurvey:
    """The fleet after `seconds` of listening. `refused` counts what was refused, by reason.

    `stations` are the node ids of the fixed stations whose position is known.
    """

    seconds: float
    vehicles: tuple[VehicleSurvey, ...] = ()
    refused: Mapping[str, int] = field(default_factory=dict)
    host_is_synchronised: bool | None = None
    stations: frozenset[int] = frozenset()


def right(text: str) -> Finding:
    """All is well."""
    return Finding(Severity.RIGHT, text)


def note(text: str, remedy: str | None = None, parameter: tuple[str, float] | None = None) -> Finding:
    """Worth knowing; stops nothing."""
    return Finding(Severity.NOTE, text, remedy, parameter)


def stop(text: str, remedy: str | None = None, parameter: tuple[str, float] | None = None) -> Finding:
    """Would stop co-localisation."""
    return Finding(Severity.STOP, text, remedy, parameter)
