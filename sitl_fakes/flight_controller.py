"""One vehicle's flight controller: autopilot, parameters, boot clock and message rates.

A reboot restarts all of them except the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import count
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fakes.ardupilot import ArduPilot
from sitl_fakes.autopilot import Autopilot
from sitl_fakes.faults import ActiveFaults, ClockJump, Fault, GpsJammed, GpsSpoofed, Reboot
from sitl_fakes.flight import Flight
from sitl_fakes.geodesy import WorldFrame
from sitl_fakes.guidance import Guidance
from sitl_fakes.parameters import Kind, Parameters
from sitl_fakes.px4 import Px4
from sitl_fakes.scenario import Scenario
from sitl_fakes.scenario import Vehicle as VehicleSpec
from sitl_fakes.sensors import Purpose, RangeSample, stream
from sitl_fakes.streams import Streams
from sitl_fakes.telemetry import Snapshot
from sitl_fakes.wire import debug_range, named_range, peer_range_frame, ranging_beacon

_BOOTING_FOR_S = 5.0  # chosen: as an autopilot boots
_FORWARD_BAD_CRC = 8  # source: ArduPilot's GCS.h, MAVn_OPTIONS
_GROUND_STATION = 255  # source: MAVLink, usual id of a ground station
_MAX_LAG_S = 0.5  # source: ArduPilot's JitterCorrection
_CONVERGES_OVER = 100  # messages; same source
_AUTOPILOTS: dict[Kind, type[ArduPilot] | type[Px4]] = {"ardupilot": ArduPilot, "px4": Px4}


class FlightController:
    """What speaks MAVLink in one vehicle. `unix_epoch_s` is the UNIX time of the simulation's time zero."""

    def __init__(
        self,
        scenario: Scenario,
        spec: VehicleSpec,
        frame: WorldFrame,
        flight: Flight,
        guidance: Guidance,
        seed: int,
        unix_epoch_s: float,
    ) -> None:
        self.sysid = spec.sysid
        self.kind: Kind = spec.autopilot
        self.frame = frame
        self.params = Parameters(spec.sysid, spec.params, spec.autopilot)
        self.faults = ActiveFaults(spec.sysid, scenario.fault, self.params, scenario.origin.lat_deg)
        self._scenario = scenario
        self._stations = {station.node: station for station in scenario.station}
        self._flight = flight
        self._guidance = guidance
        self._seed = seed
        self._unix_epoch_s = unix_epoch_s
        rng = stream(seed, Purpose.CLOCK, spec.sysid)
        offset, drift = float(rng.uniform(10.0, 600.0)), float(rng.uniform(-20.0, 20.0))
        self.clock = BootClock(
            offset if spec.boot_offset_s is None else spec.boot_offset_s,
            drift if spec.clock_drift_ppm is None else spec.clock_drift_ppm,
        )
        self._booting_until_s: float | None = None
        self._start_autopilot(0.0)
        self.autopilot.armed = spec.armed

    def _start_autopilot(self, at_s: float) -> None:
        self.autopilot: Autopilot = _AUTOPILOTS[self.kind](self.params, self._guidance)
        self.offboard_clock = OffboardClock()
        self._mav = mavlink.MAVLink(None, srcSystem=self.sysid, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._ground_station = mavlink.MAVLink(None, srcSystem=_GROUND_STATION, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._sequence = count()
        phases = stream(self._seed, Purpose.PHASES, self.sysid)
        self.streams = Streams(self.kind, self.params, phases, at_s, self._scenario.truth_messages)

    @property
    def booting(self) -> bool:
        """Whether it is restarting: it neither steers, listens nor speaks."""
        return self._booting_until_s is not None

    @property
    def altitude_m(self) -> float:
        """Altitude above mean sea level that the autopilot believes, m."""
        return self._flight.air.altitude_m + self.autopilot.height.error_m

    def run(self, active: Iterable[Fault], at_s: float) -> None:
        """Apply the faults in force that concern the controller at a time (s).

        A reboot begins or is over, or the clock jumps.
        """
        for fault in active:
            if isinstance(fault, Reboot):
                self.faults.remove(fault)
                self.clock.restart(at_s)
                self._booting_until_s = at_s + _BOOTING_FOR_S
            elif isinstance(fault, ClockJump):
                self.faults.remove(fault)
                self.clock.jump(fault.by_s)
        if self._booting_until_s is not None and at_s >= self._booting_until_s:
            self._booting_until_s = None
            armed = self.autopilot.armed
            self._start_autopilot(at_s)
            self.autopilot.armed = armed

    def heading_command_rad(self, at_s: float, step_s: float) -> float:
        """Heading to fly over the step that ends at a time, rad.

        While it boots nobody steers: the heading is held.
        """
        air = self._flight.air
        return air.heading_rad if self.booting else self.autopilot.heading_command_rad(air, at_s, step_s)

    def pack(self, message: Any) -> bytes:
        """Encode a message under the next sequence number."""
        self._mav.seq = self._next_sequence()
        return bytes(message.pack(self._mav))

    def pack_range(self, sample: RangeSample, at_s: float) -> bytes | None:
        """Encode a measured range as the scenario wants it sent.

        None where the autopilot drops its companion's message. PX4 forwards no message that it does not know; ArduPilot only from
        a port with MAVn_OPTIONS bit 3 (FORWARD_BAD_CRC).
        """
        ranging, boot_s = self._scenario.ranging, self.clock.boot_s(at_s)
        forwards_unknown = bool(int(self.params.get("MAV2_OPTIONS", 0.0)) & _FORWARD_BAD_CRC)
        if ranging.message == "peer_range" and not (ranging.companion_link or forwards_unknown):
            return None
        station = self._stations.get(sample.peer)
        peer, station_id = (sample.peer, None) if station is None else (0, station.id)
        if ranging.message == "named_value":
            return self.pack(named_range(boot_s, peer, sample.range_m, station_id))
        time_s = boot_s if ranging.time_base == "boot" else self._unix_epoch_s + at_s
        if ranging.message == "debug_vect":
            return self.pack(debug_range(round(time_s * 1e6), peer, sample.range_m, sample.stated_sigma_m, station_id))
        fields = round(time_s * 1e6), peer, sample.range_m, sample.stated_sigma_m, sample.sequence
        if ranging.message == "peer_range":
            return peer_range_frame(
                self.sysid, mavlink.MAV_COMP_ID_AUTOPILOT1, self._next_sequence(), *fields, station=station_id
            )
        lla = None if station is None else self.frame.to_lla(station.east_m, station.north_m, station.height_m)
        return self.pack(ranging_beacon(*fields, station_id, lla))

    def pack_forwarded(self) -> bytes:
        """Encode the heartbeat of a ground station on another port, under its own system id."""
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        return bytes(beat.pack(self._ground_station))

    def _next_sequence(self) -> int:
        return next(self._sequence) % 256

    def snapshot(self, at_s: float) -> Snapshot:
        """Return what telemetry is made from, now."""
        first, second = (receiver.fixed_at_s for receiver in self.autopilot.receivers)
        noticed = [fault for fault in self.faults.active(at_s) if isinstance(fault, GpsJammed | GpsSpoofed) and fault.reported]
        return Snapshot(
            kind=self.kind,
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
            second_receiver=self.params.get("GPS2_TYPE", 0.0) != 0,
            notices_jamming=any(isinstance(fault, GpsJammed) for fault in noticed),
            notices_spoofing=any(isinstance(fault, GpsSpoofed) for fault in noticed),
            flight=self._flight,
            altitude_m=self.altitude_m,
            climb_mps=self._flight.climb_mps + self.autopilot.height.climb_error_mps,
        )


class BootClock:
    """A vehicle's time since boot: it has an offset and a drift, and may jump."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._zero_at_s = 0.0
        self._offset_s = offset_s
        self._rate = 1.0 + drift_ppm * 1e-6

    def boot_s(self, at_s: float) -> float:
        """Boot time (s) at a time of the simulation (s)."""
        return self._offset_s + (at_s - self._zero_at_s) * self._rate

    def jump(self, by_s: float) -> None:
        """Step by a time (s), forwards or back, as a clock does that is set."""
        self._offset_s += by_s

    def restart(self, at_s: float) -> None:
        """Count from zero from a time of the simulation (s) on."""
        self._zero_at_s = at_s
        self._offset_s = 0.0


class OffboardClock:
    """A converter of the times in one sender's messages to local times.

    It treats the shortest delay of the messages as none, as ArduPilot's JitterCorrection does.
    """

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._least_s = math.inf
        self._samples = 0

    def to_local_s(self, sent_s: float, received_s: float) -> float:
        """Return the local time (s) of a sender's time (s) in a message received just now.

        It is never later than now, nor earlier by more than 0.5 s.
        """
        difference_s = received_s - sent_s
        self._offset_s = min(self._offset_s, difference_s)
        if sent_s + self._offset_s < received_s - _MAX_LAG_S:
            self._offset_s = difference_s - _MAX_LAG_S
        self._least_s = min(self._least_s, difference_s)
        self._samples += 1
        local_s = sent_s + self._offset_s
        if self._samples == _CONVERGES_OVER:
            self._offset_s, self._least_s, self._samples = self._least_s, math.inf, 0
        return local_s
