"""A closed loop of a simulated fleet and the engine in one process, on simulated time.

The fakes' datagrams go through the same decoder, engine and encoder as on a wire; only sockets and waiting are left out.
"""

from __future__ import annotations

import copyreg
from dataclasses import dataclass, field
from struct import Struct

import numpy as np

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import Estimate, FloatArray
from gcs_coloc.core.messages.control import ClockReference, RouteReport
from gcs_coloc.core.messages.outbound import GpsInput, HealthChanged, ToVehicle
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.encoder import Encoder
from sitl_fakes.fleet import STEP_S, Fleet
from sitl_fakes.flight import VehicleTruth
from sitl_fakes.scenario import Scenario

_UNIX_EPOCH_S = 1_780_000_000.0  # any; in 2026
_SAMPLE_S = 0.2  # chosen: as often as the fleet is reviewed

# Each simulated aircraft's codec, pymavlink's, has one, and Python does not know how to copy it.
copyreg.pickle(Struct, lambda struct: (Struct, (struct.format,)))


@dataclass(slots=True)
class Sample:
    """One vehicle at one time (s): truth, the engine's answer, and what its autopilot flies on.

    `error_enu_m` (3,) is estimate minus truth in metres, `covariance` (3, 3) of it; both None where the engine has no answer.
    """

    at_s: float
    truth: VehicleTruth
    gps_state: str
    error_enu_m: FloatArray | None
    covariance: FloatArray | None
    hdop: float | None


@dataclass(slots=True)
class Flight:
    """What was sampled of each vehicle, by system id, and the changes of GPS health."""

    samples: dict[int, list[Sample]] = field(default_factory=dict)
    changes: list[HealthChanged] = field(default_factory=list)
    gps_inputs: dict[int, int] = field(default_factory=dict)


def fly(
    scenario: Scenario,
    seed: int,
    engine: Engine,
    *,
    duration_s: float | None = None,
    aided: bool = True,
) -> Flight:
    """Fly a scenario against a fresh engine.

    Args:
        scenario: what flies.
        seed: of all the fakes' noise.
        engine: a fresh engine; its service clock is the simulated time.
        duration_s: the scenario's own where None.
        aided: whether the vehicles get what the engine sends.

    Returns:
        The flight, sampled five times a second from the time the engine knows its frame.
    """
    loop = ClosedLoop(scenario, seed, engine, aided=aided)
    loop.advance(duration_s if duration_s is not None else scenario.duration_s)
    return loop.flight


class ClosedLoop:
    """A flight under way: the fleet, the engine that it talks to, and what was sampled of it so far.

    A deep copy flies on by itself, so that many flights can share a beginning.
    """

    def __init__(self, scenario: Scenario, seed: int, engine: Engine, *, aided: bool = True) -> None:
        self.fleet = Fleet(scenario, seed, _UNIX_EPOCH_S)
        self.engine = engine
        self.flight = Flight({sysid: [] for sysid in self.fleet.sysids})
        self._aided = aided
        self._decoder, self._encoder = Decoder(), Encoder()
        self._step = 0
        engine.receive(ClockReference(0.0, _UNIX_EPOCH_S))

    def advance(self, to_s: float) -> None:
        """Fly until a simulated time (s), that one included."""
        every = round(_SAMPLE_S / STEP_S)
        for step in range(self._step, round(to_s / STEP_S) + 1):
            now_s = step * STEP_S
            for datagram in self.fleet.advance(now_s):
                arrived_s = min(datagram.due_s, now_s)
                self._poll(arrived_s)
                for frame in self._decoder.decode(datagram.payload, arrived_s, datagram.sysid):
                    if frame.message is not None:
                        self.engine.receive(frame.message)
                    if frame.is_autopilot_heartbeat:
                        self.engine.receive(RouteReport(frame.sysid, arrived_s, None))
            self._poll(now_s)
            if step % every == 0:
                _sample(self.engine, now_s, self.fleet, self.flight)
            self._step = step + 1

    def _poll(self, until_s: float) -> None:
        while self.engine.next_deadline() <= until_s:
            at_s = max(self.engine.next_deadline(), 0.0)
            for output in self.engine.poll(at_s):
                if isinstance(output, HealthChanged):
                    self.flight.changes.append(output)
                elif isinstance(output, ToVehicle):
                    if isinstance(output, GpsInput):
                        self.flight.gps_inputs[output.sysid] = self.flight.gps_inputs.get(output.sysid, 0) + 1
                    if self._aided:
                        frames = self._encoder.encode(output, output.sysid)
                        self.fleet.deliver(output.sysid, frames, max(at_s, self.fleet.now_s))


def _sample(engine: Engine, now_s: float, fleet: Fleet, flight: Flight) -> None:
    frame = engine.frame
    if frame is None:
        return
    for sysid, truth in fleet.truth().items():
        answer = engine.estimate(sysid, now_s)
        error, covariance, hdop = None, None, None
        if isinstance(answer, Estimate):
            error = answer.position_enu_m - np.array(frame.enu_from_geodetic(truth.lat_deg, truth.lon_deg, truth.alt_msl_m))
            covariance, hdop = answer.covariance[:3, :3], answer.hdop
        state = engine.gps_state(sysid).value
        flight.samples[sysid].append(Sample(now_s, truth, state, error, covariance, hdop))
