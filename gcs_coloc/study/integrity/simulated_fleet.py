"""A simulated fleet of one trial: what its vehicles send, and when it arrives.

The vehicles also react to what the engine sends them.

Motion, errors and links are the trials' own; messages are the frozen ones that the engine receives. A vehicle without a fix
reports dead reckoning, or the fix that it was sent. The vehicles fly where they would with GPS: aiding does not move them.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from math import hypot, inf, sqrt

import numpy as np

from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.inbound import (
    Autopilot,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    PeerRange,
    SystemHealth,
    TimeBase,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import GpsInput, Outbound, TimeSyncRequest
from gcs_coloc.study.integrity.flight_classes import FlightClass
from gcs_coloc.study.integrity.motion import Trajectory, draw_trajectories
from gcs_coloc.study.integrity.sensor_errors import (
    BarometerJump,
    Fault,
    LinkErrors,
    PairErrors,
    PitotFailure,
    ReceiverErrors,
    direction,
    draw_flicker,
    draw_reboot,
    is_within,
    scaled,
    uniform_sign,
)
from gcs_coloc.study.integrity.simulated_vehicle import UNIX_EPOCH_S, SimulatedVehicle
from sitl_fakes.geodesy import WorldFrame

DENIED = 100
"""System id of the first denied vehicle; peers count from 1."""
_ORIGIN_SETTER = 50
"""The far vehicle whose position becomes the origin of the fleet's frame."""
_FOLLOWED_AFTER_S = 10.0
"""An autopilot that refuses a step of its receiver takes it up after so long. Source: EKF3's retry time of 10 s."""
_STEP_BEYOND_S = 0.001
"""The last event is so long after the flight's end, so that there is always one to pop until then."""
_COMPANION_BEHIND_S = 3.0
"""Chosen: nobody has set the clock of a companion computer."""
_PERIODS_S = {
    "heartbeat": 1.0, "receiver": 0.2, "attitude": 0.1, "airspeed": 0.2, "health": 0.5, "ekf": 0.5, "time": 1.0,
}  # fmt: skip


_Build = Callable[[float], list[Inbound]]
"""Builds what a vehicle sends at a time (s)."""


class SimulatedFleet:
    """One draw of a class.

    `pop` returns what arrives next; `deliver` hands over what the engine sends. `courses` are the vehicles' ways, the denied
    ones first; None: drawn as well. `stations_m` are the true places of fixed stations, m, by node id; the denied vehicles range
    them.
    """

    def __init__(
        self,
        drawn: FlightClass,
        seed: int,
        duration_s: float,
        courses: Sequence[Trajectory] | None = None,
        stations_m: Mapping[int, Vector3] | None = None,
    ) -> None:
        self.drawn, self.duration_s = drawn, duration_s
        self._stations_m = stations_m or {}
        self._rng = rng = np.random.default_rng([seed, *drawn.name.encode()])
        self.frame = WorldFrame(rng.uniform(-60.0, 60.0), rng.uniform(-180.0, 180.0), rng.uniform(0.0, 600.0))
        peers = len(courses) - drawn.denied if courses is not None else int(rng.integers(drawn.peers[0], drawn.peers[1] + 1))
        self.denied = tuple(range(DENIED, DENIED + drawn.denied))
        self.peers = tuple(range(1, peers + 1))
        sysids = (*self.denied, *self.peers)
        if courses is None:
            courses = draw_trajectories(rng, drawn, duration_s, len(sysids))
        common_m = ReceiverErrors.common_m(rng, drawn, duration_s)
        delay_s = rng.uniform(*drawn.delay_s)
        self._vehicles: dict[int, SimulatedVehicle] = {}
        for sysid, course in zip(sysids, courses, strict=True):
            errors = ReceiverErrors(rng, drawn, common_m, duration_s)
            link = LinkErrors(rng, drawn, delay_s if drawn.is_delay_alike else rng.uniform(*drawn.delay_s), duration_s)
            reckoning_mps = scaled(rng.uniform(0.3, 3.0), direction(rng))
            vehicle = SimulatedVehicle(sysid, self.frame, rng, drawn, course, errors, link, reckoning_mps)
            self._vehicles[sysid] = vehicle
        self.lost_at_s = rng.uniform(*drawn.lost_at_s)
        self.fault_at_s = inf
        self._device_fault_m = (0.0, 0.0)
        self._device = 0
        self._set_back_s = 0.0
        self._draw_faults()
        self._silences = self._draw_silences()
        if drawn.attitude_freezes:
            self._vehicles[self.denied[0]].frozen = self._silences
        self.rebooted = tuple(self._draw_reboots())
        self._pairs = self._draw_pairs()
        self._heap: list[tuple[float, int, Callable[[float], None] | Inbound]] = []
        self._ties = count()
        self._push_first_events()

    def truth_m(self, sysid: int, at_s: float) -> Vector3:
        """Return the true position of a vehicle, m in `frame`."""
        return self._vehicles[sysid].course.position(at_s)

    def error_m(self, sysid: int, at_s: float, lat_deg: float, lon_deg: float, alt_m: float) -> float:
        """Return how far a position is from where a vehicle truly is, horizontally, m."""
        east_m, north_m, _ = self.frame.to_enu(lat_deg, lon_deg, alt_m)
        true_m = self.truth_m(sysid, at_s)
        return hypot(east_m - true_m[0], north_m - true_m[1])

    def is_spoofed(self, sysid: int, at_s: float) -> bool:
        """Whether a vehicle's receiver is faulty at a time."""
        vehicle = self._vehicles[sysid]
        return (vehicle.fault is not None and at_s >= vehicle.fault.at_s) or vehicle.flicker is not None

    def spoofed(self) -> tuple[int, ...]:
        """Return the vehicles whose receivers become faulty, but those that only flicker."""
        return tuple(sysid for sysid, vehicle in self._vehicles.items() if vehicle.fault is not None)

    def pop(self) -> tuple[float, Inbound | None]:
        """Return the time of the next event, and the message where one arrives at the service then."""
        at_s, _, event = heapq.heappop(self._heap)
        if callable(event):
            event(at_s)
            return at_s, None
        return at_s, event

    def deliver(self, output: Outbound, sent_s: float) -> None:
        """Hand what the engine sends to the vehicle, which gets it after its link's delay."""
        if isinstance(output, GpsInput):
            vehicle = self._vehicles[output.sysid]
            if vehicle.link.is_silent(sent_s):
                return
            self._push(vehicle.link.delivery_s(sent_s), lambda at_s: vehicle.set_aid(output, at_s))
        elif isinstance(output, TimeSyncRequest) and self.drawn.answers_timesync:
            vehicle = self._vehicles[output.sysid]
            self._push(vehicle.link.delivery_s(sent_s), lambda at_s: self._answer(vehicle, output.ts1_ns, at_s))

    # Drawing

    def _draw_faults(self) -> None:
        rng, drawn = self._rng, self.drawn
        self.fault_at_s = rng.uniform(self.lost_at_s + 20.0, max(self.lost_at_s + 20.0, 0.6 * self.duration_s))
        spoofing = drawn.spoofing
        if spoofing is not None:
            if spoofing.own:
                self.fault_at_s = self.lost_at_s
            away, step_m, ramp_mps = direction(rng), rng.uniform(*spoofing.step_m), rng.uniform(*spoofing.ramp_mps)
            followed_s = _FOLLOWED_AFTER_S if step_m > 0.0 and rng.random() < 0.5 else 0.0
            moves_doppler = bool(rng.random() < 0.5)
            whose = self.denied[:1] if spoofing.own else rng.permutation(self.peers)[: spoofing.receivers].tolist()
            for sysid in whose:
                if not spoofing.is_alike:
                    away = direction(rng)
                self._vehicles[sysid].fault = Fault(self.fault_at_s, step_m, ramp_mps, away, followed_s, moves_doppler)
        if spoofing is None or not spoofing.own:
            for sysid in self.denied:
                self._vehicles[sysid].lost_at_s = self.lost_at_s
                if drawn.flickers:
                    self._vehicles[sysid].flicker = draw_flicker(rng, self.lost_at_s, self.duration_s)
        self._device_fault_m = (uniform_sign(rng, drawn.device_step_m), uniform_sign(rng, drawn.device_ramp_mps))
        self._device = int(rng.choice((*self.denied, *self.peers)))
        self._set_back_s = rng.uniform(*drawn.companion_set_back_s) if any(drawn.companion_set_back_s) else 0.0
        if drawn.pitot_fails:
            self._vehicles[self.denied[0]].pitot_failure = PitotFailure.draw(rng, self.fault_at_s)
        if drawn.height_jump_m[1] > 0.0:
            self._vehicles[self.denied[0]].barometer_jump = BarometerJump.draw(rng, self.fault_at_s, drawn.height_jump_m)

    def _draw_silences(self) -> list[tuple[float, float]]:
        if self.drawn.silence_s[1] == 0.0:
            return []
        first_s = self.lost_at_s + 15.0
        starts = (self._rng.uniform(first_s, max(first_s, self.duration_s - 25.0)) for _ in range(2))
        return [(start, start + self._rng.uniform(*self.drawn.silence_s)) for start in starts]

    def _draw_reboots(self) -> list[int]:
        if not self.drawn.reboots:
            return []
        whose = [self.denied[0], int(self._rng.choice(self.peers))]
        for sysid in whose:
            self._vehicles[sysid].link.add_reboot(*draw_reboot(self._rng, self.lost_at_s + 10.0, self.duration_s))
        return whose

    def _draw_pairs(self) -> dict[tuple[int, int], PairErrors]:
        rng, drawn, pairs = self._rng, self.drawn, {}
        sigma_m = rng.uniform(*drawn.range_sigma_m)
        spans = (drawn.range_bias_m, drawn.range_scale)
        devices = {sysid: [uniform_sign(rng, span) for span in spans] for sysid in self._vehicles}
        sysids = (*self.denied, *self.peers)
        off = (self.denied[0], int(rng.choice(self.peers))) if any(drawn.pair_detour_m) else None
        for i, a in enumerate(sysids):
            for b in sysids[i + 1 :]:
                if drawn.is_mutual or a in self.denied:
                    # The responder's part of a two-way range is half of the measuring device's.
                    bias_m, scale = (devices[a][k] + 0.5 * devices[b][k] for k in (0, 1))
                    bias_m += rng.uniform(*drawn.pair_detour_m) if (a, b) == off else 0.0
                    pairs[a, b] = PairErrors(rng, drawn, sigma_m, bias_m, scale, self.duration_s)
        for station in self._stations_m:
            for a in self.denied:
                pairs[a, station] = PairErrors(rng, drawn, sigma_m, devices[a][0], devices[a][1], self.duration_s)
        return pairs

    # Events

    def _push(self, at_s: float, event: Callable[[float], None] | Inbound) -> None:
        heapq.heappush(self._heap, (at_s, next(self._ties), event))

    def _push_first_events(self) -> None:
        rng, drawn = self._rng, self.drawn
        slowest_s = rng.uniform(*drawn.telemetry_s) if any(drawn.telemetry_s) else 0.0
        self._push(self.duration_s + _STEP_BEYOND_S, lambda _: None)
        self._push(drawn.backlog_s, ClockReference(drawn.backlog_s, UNIX_EPOCH_S))
        for vehicle in self._vehicles.values():
            builders = {
                "heartbeat": vehicle.heartbeat_messages,
                "receiver": vehicle.receiver_messages,
                "position": vehicle.position_messages,
                "health": vehicle.health_messages,
                "ekf": vehicle.ekf_messages,
            }
            if drawn.has_air_data:
                builders |= {"attitude": vehicle.attitude_messages, "airspeed": vehicle.airspeed_messages}
            if drawn.has_utc:
                builders["time"] = vehicle.system_time_messages
            periods_s = _PERIODS_S | {"position": 1.0 / drawn.position_hz}
            for name, build in builders.items():
                period_s = max(periods_s[name], slowest_s)
                self._repeat(rng.uniform(0.0, period_s), period_s, vehicle, build)
        period_s = 1.0 / rng.uniform(*drawn.range_hz)
        for pair in self._pairs:
            reporter = self._vehicles[pair[0]]
            self._repeat(rng.uniform(0.0, period_s), period_s, reporter, partial(self._range_messages, reporter, pair))
        if drawn.from_origin_m > 0.0:
            self._push_origin_setter()

    def _repeat(self, first_s: float, period_s: float, vehicle: SimulatedVehicle, build: _Build) -> None:
        def run(at_s: float) -> None:
            if at_s + period_s < self.duration_s:
                self._push(at_s + period_s, run)
            if not vehicle.link.is_silent(at_s):
                for message in build(at_s):
                    self._push(message.received_at_s, message)

        self._push(first_s, run)

    def _answer(self, vehicle: SimulatedVehicle, ts1_ns: int, at_s: float) -> None:
        if not vehicle.link.is_silent(at_s):
            arrival_s = vehicle.arrival_s(at_s)
            self._push(arrival_s, TimeSyncAnswer(vehicle.sysid, arrival_s, ts1_ns, round(vehicle.link.boot_s(at_s) * 1e9)))

    def _push_origin_setter(self) -> None:
        """A vehicle at rest, far off, is heard first, so that the fleet's origin is at it."""
        towards = direction(self._rng)
        east_m, north_m, _ = scaled(self.drawn.from_origin_m, scaled(self._rng.uniform(0.4, 1.0), towards))
        lat, lon, alt = self.frame.to_lla_at(east_m, north_m, 100.0)
        for k in range(round(self.duration_s * 5.0)):
            t = 0.001 + 0.2 * k
            if k % 5 == 0:
                self._push(t, Heartbeat(_ORIGIN_SETTER, t, Autopilot.ARDUPILOT, True, False))
                self._push(t, SystemHealth(_ORIGIN_SETTER, t, True, True, True))
            self._push(t, GpsReceiver(_ORIGIN_SETTER, t, 0, 3, lat, lon, alt, 14, 0.8, 1.0, 1.6, 0.2, t))
            self._push(t, GlobalPosition(_ORIGIN_SETTER, t, t, lat, lon, alt, 0.0, 0.0, 0.0))

    def _range_messages(self, vehicle: SimulatedVehicle, pair: tuple[int, int], at_s: float) -> list[Inbound]:
        peer = self._vehicles.get(pair[1])
        if is_within(self._silences, at_s) or (peer is not None and peer.link.is_off(at_s)):
            return []
        there_m = peer.course.position(at_s) if peer is not None else self._stations_m[pair[1]]
        apart_m = np.subtract(vehicle.course.position(at_s), there_m)
        true_m = sqrt(apart_m.dot(apart_m))
        if true_m > self.drawn.max_range_m:
            return []
        errors = self._pairs[pair]
        range_m = errors.measure(true_m, at_s)
        if range_m is None:
            return []
        if self._device in pair and at_s >= self.fault_at_s:
            step_m, ramp_mps = self._device_fault_m
            range_m = max(range_m + step_m + ramp_mps * (at_s - self.fault_at_s), 0.0)
        arrival_s, stamp_s, clock = vehicle.arrival_s(at_s), vehicle.link.boot_s(at_s), TimeBase.BOOT
        if any(self.drawn.companion_wait_s) or self._set_back_s > 0.0:
            arrival_s += self._rng.uniform(*self.drawn.companion_wait_s)
            stamp_s, clock = UNIX_EPOCH_S + at_s - _COMPANION_BEHIND_S, TimeBase.UNIX
            if vehicle.sysid in self.denied and at_s >= self.fault_at_s:
                stamp_s -= self._set_back_s
        return [PeerRange(vehicle.sysid, arrival_s, pair[1], range_m, errors.sigma_m, stamp_s, clock, None, None, 0)]
