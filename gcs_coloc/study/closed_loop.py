"""A closed loop of a simulated fleet and the engine in one process, by MAVLink bytes, on simulated time.

The fakes' datagrams go through the same decoder, engine and encoder as on a wire; only sockets and waiting are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

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

_UNIX_EPOCH_S = 1_780_000_000.0
_SAMPLE_S = 0.2


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
    progress: Callable[[float], None] = lambda _: None,
) -> Flight:
    """Fly a scenario against a fresh engine.

    Args:
        scenario: what flies.
        seed: of all the fakes' noise.
        engine: a fresh engine; its service clock is the simulated time.
        duration_s: the scenario's own where None.
        aided: whether the vehicles get what the engine sends.
        progress: called with the simulated time, s.

    Returns:
        The flight, sampled five times a second from the time the engine knows its frame.
    """
    fleet = Fleet(scenario, seed, _UNIX_EPOCH_S)
    decoder, encoder = Decoder(), Encoder()
    flight = Flight({sysid: [] for sysid in fleet.sysids})
    steps = round((duration_s if duration_s is not None else scenario.duration_s) / STEP_S)
    every = round(_SAMPLE_S / STEP_S)
    engine.receive(ClockReference(0.0, _UNIX_EPOCH_S))
    for step in range(steps + 1):
        now_s = step * STEP_S
        for datagram in fleet.advance(now_s):
            arrived_s = min(datagram.due_s, now_s)
            _poll(engine, arrived_s, fleet, encoder, flight, aided)
            for frame in decoder.decode(datagram.payload, arrived_s, datagram.sysid):
                if frame.message is not None:
                    engine.receive(frame.message)
                if frame.is_autopilot_heartbeat:
                    engine.receive(RouteReport(frame.sysid, arrived_s, None))
        _poll(engine, now_s, fleet, encoder, flight, aided)
        if step % every == 0:
            _sample(engine, now_s, fleet, flight)
            progress(now_s)
    return flight


def _poll(engine: Engine, until_s: float, fleet: Fleet, encoder: Encoder, flight: Flight, aided: bool) -> None:
    while engine.next_deadline() <= until_s:
        at_s = max(engine.next_deadline(), 0.0)
        for output in engine.poll(at_s):
            if isinstance(output, HealthChanged):
                flight.changes.append(output)
            elif isinstance(output, ToVehicle):
                if isinstance(output, GpsInput):
                    flight.gps_inputs[output.sysid] = flight.gps_inputs.get(output.sysid, 0) + 1
                if aided:
                    fleet.deliver(output.sysid, encoder.encode(output, output.sysid), max(at_s, fleet.now_s))


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
