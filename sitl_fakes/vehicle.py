"""One simulated vehicle: its flight, GPS and ranging sensors, autopilot, telemetry and radio link, stepped by simulated time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.autopilot import Autopilot
from sitl_fakes.clock import BootClock
from sitl_fakes.commands import handle
from sitl_fakes.dynamics import turn_radius_m
from sitl_fakes.fault_board import FaultBoard
from sitl_fakes.faults import Fault, LinkDropout, Reboot
from sitl_fakes.flight import Flight
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.guidance import Guidance, Route
from sitl_fakes.link import Link
from sitl_fakes.parameters import Parameters
from sitl_fakes.ranging import Ranger, RangeSample
from sitl_fakes.scenario import Scenario
from sitl_fakes.scenario import Vehicle as VehicleSpec
from sitl_fakes.seeds import Purpose, stream
from sitl_fakes.sensors import GpsSensor
from sitl_fakes.snapshot import Snapshot
from sitl_fakes.telemetry import Streams
from sitl_fakes.truth import VehicleTruth
from sitl_fakes.wire import named_range, peer_range_frame, ranging_beacon_frame

_BOOTING_FOR_S = 5.0
_EPSILON_S = 1e-9


class Vehicle:
    """One vehicle of a fleet. `unix_epoch_s` is the UNIX time of the simulation's time zero."""

    def __init__(self, scenario: Scenario, spec: VehicleSpec, frame: WorldFrame, seed: int, unix_epoch_s: float) -> None:
        self.sysid = spec.sysid
        self.frame = frame
        self.params = Parameters(spec.sysid, spec.params)
        self.faults = FaultBoard(spec.sysid, scenario.fault, self.params, scenario.origin.lat_deg)
        self._scenario = scenario
        self._seed = seed
        self._unix_epoch_s = unix_epoch_s
        rng = stream(seed, Purpose.CLOCK, spec.sysid)
        offset, drift = float(rng.uniform(10.0, 600.0)), float(rng.uniform(-20.0, 20.0))
        self.clock = BootClock(
            offset if spec.boot_offset_s is None else spec.boot_offset_s,
            drift if spec.clock_drift_ppm is None else spec.clock_drift_ppm,
        )
        airspeed = spec.airspeed_mps or scenario.airspeed_mps
        self._route = Route(spec.waypoints, spec.end_of_route or scenario.end_of_route, scenario.hold_radius_m)
        self._guidance = Guidance(self._route, airspeed, scenario.waypoint_radius_m or turn_radius_m(airspeed))
        start = spec.waypoints[0]
        heading = self._route.track(0).track_heading_rad(start)
        self._flight = Flight(scenario, spec.sysid, frame, seed, start, heading, spec.height_m, airspeed)
        self._gps = GpsSensor(scenario.gps, spec.sysid, seed)
        self._gps_due_s = 0.0
        self._ranger = Ranger(scenario.ranging, spec.sysid, scenario.ranging_peers(spec), seed)
        self._downlink = Link(scenario.telemetry, stream(seed, Purpose.DOWNLINK, spec.sysid))
        self._uplink = Link(scenario.telemetry, stream(seed, Purpose.UPLINK, spec.sysid))
        self._booting_until_s: float | None = None
        self._start_autopilot(0.0)

    def _start_autopilot(self, at_s: float) -> None:
        self.autopilot = Autopilot(self.params, self._guidance)
        self._mav = mavlink.MAVLink(None, srcSystem=self.sysid, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._sequence = count()
        self.streams = Streams(stream(self._seed, Purpose.PHASES, self.sysid), at_s, self._scenario.truth_messages)

    @property
    def position_m(self) -> Vector:
        """True position: east, north, up, m."""
        return self._flight.position_m

    @property
    def altitude_m(self) -> float:
        """Barometric altitude above mean sea level, m."""
        return self._flight.air.altitude_m

    def receive(self, payload: bytes, at_s: float) -> None:
        """Put a datagram on the uplink at a time (s)."""
        if not any(isinstance(f, LinkDropout) for f in self.faults.active(at_s)):
            self._uplink.send(payload, at_s)

    def sent(self, by_s: float) -> list[tuple[float, bytes]]:
        """Take what has come down the link by a time (s): arrival time and datagram."""
        return self._downlink.arrived(by_s)

    def fly(self, at_s: float, step_s: float) -> None:
        """Fly the step that ends at `at_s`. While the autopilot boots nobody steers: the heading is held."""
        if self._booting_until_s is not None:
            command = self._flight.air.heading_rad
        else:
            command = self.autopilot.heading_command_rad(self._flight.air, at_s, step_s)
        self._flight.step(command, step_s)

    def work(self, at_s: float, positions_m: Mapping[int, Vector]) -> None:
        """Sense, listen and speak at a time (s), given the true positions (m) of all vehicles."""
        active = self.faults.active(at_s)
        self._boot(active, at_s)
        booting = self._booting_until_s is not None
        if self._gps_due_s <= at_s + _EPSILON_S:
            self._gps_due_s += self._gps.interval_s
            fix = self._gps.measure(self._flight.position_m, self._flight.velocity_mps, active, at_s)
            if not booting:
                self.autopilot.receive_own_fix(fix, at_s)
        samples = self._ranger.measure(at_s, self.position_m, positions_m, active)
        received = [payload for _, payload in self._uplink.arrived(at_s + _EPSILON_S)]
        if booting:
            return
        messages = [reply for payload in received for reply in handle(self, payload, at_s)]
        messages += self.streams.due(at_s, self.snapshot)
        frames = [self._pack(message) for message in messages] + [self._range_frame(sample, at_s) for sample in samples]
        if not any(isinstance(f, LinkDropout) for f in active):
            for frame in frames:
                self._downlink.send(frame, at_s)

    def _boot(self, active: list[Fault], at_s: float) -> None:
        for fault in active:
            if isinstance(fault, Reboot):
                self.faults.remove(fault)
                self.clock.restart(at_s)
                self._booting_until_s = at_s + _BOOTING_FOR_S
        if self._booting_until_s is not None and at_s >= self._booting_until_s:
            self._booting_until_s = None
            self._start_autopilot(at_s)

    def _next_sequence(self) -> int:
        return next(self._sequence) % 256

    def _pack(self, message: Any) -> bytes:
        self._mav.seq = self._next_sequence()
        return bytes(message.pack(self._mav))

    def snapshot(self, at_s: float) -> Snapshot:
        """Return what telemetry is made from, now."""
        first, second = (receiver.fixed_at_s for receiver in self.autopilot.receivers)
        return Snapshot(
            at_s=at_s,
            boot_s=self.clock.boot_s(at_s),
            fixed_boot_s=(
                None if first is None else self.clock.boot_s(first),
                None if second is None else self.clock.boot_s(second),
            ),
            unix_s=self._unix_epoch_s + at_s if self.autopilot.had_gps_time else None,
            frame=self.frame,
            home_alt_m=self._scenario.origin.alt_msl_m,
            global_position=self._scenario.global_position,
            autopilot=self.autopilot,
            second_receiver=self.params["GPS2_TYPE"] != 0,
            air=self._flight.air,
            climb_mps=self._flight.climb_mps,
            true_state=self._flight.state,
            true_velocity_mps=self._flight.velocity_mps,
            true_lla=self._flight.lla,
        )

    def truth(self, at_s: float) -> VehicleTruth:
        """Return what is really so, now."""
        s = self._flight.state
        at = (s.east_m, s.north_m)
        estimate = self.autopilot.navigation.position_m
        return VehicleTruth(
            at_s,
            self.sysid,
            *self._flight.position_m,
            *self._flight.velocity_mps,
            *self._flight.lla,
            roll_rad=s.phi_rad,
            heading_rad=s.psi_rad,
            leg=self._guidance.leg_index,
            cross_track_m=self._route.track(self._guidance.leg_index).cross_track_m(at),
            off_route_m=self._route.distance_m(at),
            estimate_east_m=None if estimate is None else estimate[0],
            estimate_north_m=None if estimate is None else estimate[1],
            source=self.autopilot.source(at_s),
            aid_refusal=self.autopilot.injected_refusal(at_s),
        )

    def _range_frame(self, sample: RangeSample, at_s: float) -> bytes:
        ranging, boot_s = self._scenario.ranging, self.clock.boot_s(at_s)
        if ranging.message == "named_value":
            return self._pack(named_range(boot_s, sample.peer, sample.range_m))
        time_s = boot_s if ranging.time_base == "boot" else self._unix_epoch_s + at_s
        common: dict[str, Any] = {
            "sysid": self.sysid,
            "compid": mavlink.MAV_COMP_ID_AUTOPILOT1,
            "frame_sequence": self._next_sequence(),
            "time_usec": round(time_s * 1e6),
            "peer_system": sample.peer,
            "range_m": sample.range_m,
            "range_std_m": sample.stated_sigma_m,
            "sequence": sample.sequence,
        }
        return peer_range_frame(**common) if ranging.message == "peer_range" else ranging_beacon_frame(**common)
