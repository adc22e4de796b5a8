"""The reported state of each vehicle: what it last said of itself. Telemetry alone writes it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import exp, sqrt

from gcs_coloc.core.messages.control import NO_HEARTBEAT_YET, RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    EkfStatus,
    FromVehicle,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Pressure,
    ReceiverIntegrity,
    SystemHealth,
    SystemTime,
    VtolState,
)
from gcs_coloc.core.messages.outbound import Stream
from gcs_coloc.core.telemetry.stream_requests import HeardStreams

LEAST_AIRSPEED_MPS = 5.0
"""Below it an airspeed sensor and a coordinated turn mean nothing."""

_SEA_LEVEL_K = 288.15  # Source: U.S. Standard Atmosphere 1976
_LAPSE_K_PER_M = 0.0065  # Source: the same, below the tropopause
_DENSITY_EXPONENT = 4.2559  # Source: the same; g M / (R lapse) - 1
_TROPOPAUSE_M = 11_000.0  # Source: the same
_SCALE_HEIGHT_M = 6341.6  # of the isothermal layer above
_TOP_M = 20_000.0  # Source: the same; where its isothermal layer ends
_STREAMS = {
    GlobalPosition: Stream.POSITION,
    Attitude: Stream.ATTITUDE,
    Airspeed: Stream.AIRSPEED,
    SystemHealth: Stream.SYSTEM_HEALTH,
    SystemTime: Stream.SYSTEM_TIME,
    VtolState: Stream.VTOL_STATE,
    Pressure: Stream.PRESSURE,
    ReceiverIntegrity: Stream.RECEIVER_INTEGRITY,
}
_EKF_FRESH_S = 3.0  # chosen: six periods of EKF_STATUS_REPORT at the requested rate
AIR_DATA_FRESH_S = 2.0  # chosen: ten periods of VFR_HUD at the requested rate
_CHANGES_A_RUN = 20
"""Chosen: where a run of repeats is more frequent than one in so many changes it shows nothing, as of a bridge that tells each
attitude twice. Of 51,000 attitudes of ArduPlane, ArduCopter and PX4 at 10 Hz none repeated."""


@dataclass(slots=True)
class RepeatedAttitudes:
    """The attitudes of one sender: does it repeat the same one to the last bit?

    An attitude is noisy. One that repeats is what an autopilot that hangs, or a bridge without news, has told last.
    """

    _last: Attitude | None = None
    _changes: int = 0
    _runs: int = 0
    _is_run: bool = False

    def add(self, attitude: Attitude) -> bool:
        """Add an attitude; return whether it only repeats the one before.

        The same message heard twice is known by its time and is no repeat, and a sender that often repeats is not judged.
        """
        last, self._last = self._last, attitude
        if last is not None and attitude.boot_s == last.boot_s:
            return False
        if last is None or _angles(attitude) != _angles(last):
            self._changes += 1
            self._is_run = False
            return False
        self._runs += not self._is_run
        self._is_run = True
        return self._changes > _CHANGES_A_RUN * self._runs


def _angles(attitude: Attitude) -> tuple[float, float, float]:
    return attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad


@dataclass(slots=True)
class ReportedState:
    """What one vehicle last reported of itself. Times are on the service's clock, s.

    `blocked` is why the links can send it nothing, None where they can; `blocked_wording` says it to people.
    `shared_with` are the other vehicles at its address, `route_at_s` is when the links reported that last.
    `winged`: it flies along its nose and turns by banking. `on_rotors`: not now, a VTOL hovers. `mode` is the name of its flight
    mode.
    `attitude` is the newest one that does not only repeat the one before.
    `receiver` and `integrity` are the newest messages of its own GPS receiver, not of the one that the service feeds.
    `counts`: how often each stream was heard since the first message.
    """

    sysid: int
    first_heard_s: float
    last_heard_s: float
    autopilot: Autopilot | None = None
    winged: bool = False
    on_rotors: bool = False
    armed: bool | None = None
    mode: str | None = None
    blocked: RouteBlock | None = RouteBlock.NO_HEARTBEAT
    blocked_wording: str | None = NO_HEARTBEAT_YET
    shared_with: tuple[int, ...] = ()
    route_at_s: float | None = None
    position: GlobalPosition | None = None
    attitude: Attitude | None = None
    repeated_attitudes: RepeatedAttitudes = field(default_factory=RepeatedAttitudes)
    airspeed: Airspeed | None = None
    receiver: GpsReceiver | None = None
    integrity: ReceiverIntegrity | None = None
    system: SystemHealth | None = None
    ekf: EkfStatus | None = None
    counts: Counter[Stream] = field(default_factory=Counter)

    def has_absolute_position(self, now_s: float) -> bool:
        """Return whether its EKF has reported an absolute horizontal position of late: it has been aligned."""
        ekf = self.ekf
        return ekf is not None and ekf.horizontal_position_absolute and now_s - ekf.received_at_s <= _EKF_FRESH_S

    @property
    def on_wings(self) -> bool:
        """Whether it flies along its nose now, as far as it tells."""
        return self.winged and not self.on_rotors

    def has_air_data(self, now_s: float) -> bool:
        """Return whether airspeed and attitude, both of late, show the motion: on wings and fast enough."""
        air, attitude = self.airspeed, self.attitude
        if not self.on_wings or air is None or attitude is None or air.airspeed_mps < LEAST_AIRSPEED_MPS:
            return False
        return now_s - min(air.received_at_s, attitude.received_at_s) <= AIR_DATA_FRESH_S


class Telemetry:
    """The reported states of at most `max_vehicles`; the service does not feed their `own_receiver`."""

    def __init__(self, max_vehicles: int, own_receiver: int = 0) -> None:
        self.own_receiver = own_receiver
        self._max_vehicles = max_vehicles
        self._states: dict[int, ReportedState] = {}

    def add(self, sysid: int, at_s: float) -> ReportedState | None:
        """Add a vehicle that is heard for the first time; None where the fleet is full."""
        if self.is_full:
            return None
        state = self._states[sysid] = ReportedState(sysid, at_s, at_s)
        return state

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one."""
        del self._states[sysid]

    @property
    def is_full(self) -> bool:
        """Whether there are as many vehicles as there may be."""
        return len(self._states) >= self._max_vehicles

    def update(self, message: FromVehicle) -> bool:
        """Update the reported state of a vehicle that was added.

        Return True where its GPS health and aiding need a review at once. A status that says what the last one said waits for
        the next review of the fleet.
        """
        state = self._states[message.sysid]
        state.last_heard_s = message.received_at_s
        stream = _STREAMS.get(type(message))
        if stream is not None:
            state.counts[stream] += 1
        match message:
            case GlobalPosition():
                state.position = message
            case Attitude():
                if not state.repeated_attitudes.add(message):
                    state.attitude = message
            case Airspeed():
                state.airspeed = message
            case VtolState():
                state.on_rotors = message.on_rotors
            case GpsReceiver():
                state.counts[Stream.FIRST_RECEIVER if message.receiver == 0 else Stream.SECOND_RECEIVER] += 1
                if message.receiver == self.own_receiver:
                    state.receiver = message
                return True
            case ReceiverIntegrity():
                # PX4 tells of the receiver in use, which is its own, under a number that is no instance.
                if state.autopilot is Autopilot.PX4 or message.receiver == self.own_receiver:
                    state.integrity = message
                return True
            case SystemHealth():
                before, state.system = state.system, message
                return before is None or before.gps_flags != message.gps_flags
            case EkfStatus():
                is_px4 = state.autopilot is Autopilot.PX4
                state.counts[Stream.ESTIMATOR_STATUS if is_px4 else Stream.EKF_STATUS] += 1
                last, state.ekf = state.ekf, message
                return last is None or last.flags != message.flags
            case Heartbeat():
                changed = state.autopilot is not message.autopilot
                state.autopilot, state.winged = message.autopilot, message.winged
                state.armed, state.mode = message.armed, message.mode
                return changed
        return False

    def set_route(self, report: RouteReport) -> bool:
        """Set whether the links reach a vehicle; True where that has changed for a vehicle of the fleet."""
        state = self._states.get(report.sysid)
        if state is None:
            return False
        state.shared_with, state.route_at_s = report.shared_with, report.received_at_s
        if state.blocked_wording == report.wording:
            return False
        state.blocked, state.blocked_wording = report.blocked, report.wording
        return True

    def heard_streams(self) -> Iterator[HeardStreams]:
        """Return what each vehicle whose autopilot is known has sent so far."""
        return (HeardStreams(v.sysid, v.autopilot, v.counts, v.winged) for v in self if v.autopilot is not None)

    def get(self, sysid: int) -> ReportedState | None:
        """Return the reported state of a vehicle, None where it was never heard."""
        return self._states.get(sysid)

    def __iter__(self) -> Iterator[ReportedState]:
        return iter(self._states.values())

    def __len__(self) -> int:
        return len(self._states)


def true_airspeed_mps(equivalent_mps: float, alt_msl_m: float) -> float:
    """True airspeed (m/s) from the equivalent one (m/s) at an altitude above mean sea level (m).

    VFR_HUD tells the calibrated or indicated airspeed, as MAVLink defines it. At the speeds of these aircraft both are the
    equivalent one; it is less than the true one by the root of the air's density, 5 % for each 1000 m.

    Source: density of the International Standard Atmosphere (ISO 2533) up to 20 km, beyond which it is taken as there. A day
    20 K warmer than standard leaves 3.5 %.
    """
    height_m = min(alt_msl_m, _TOP_M)
    density = (1.0 - _LAPSE_K_PER_M * min(height_m, _TROPOPAUSE_M) / _SEA_LEVEL_K) ** _DENSITY_EXPONENT
    density *= exp(-max(height_m - _TROPOPAUSE_M, 0.0) / _SCALE_HEIGHT_M)
    return equivalent_mps / sqrt(density)
