"""Receivers that come back, on flights through the engine: right, 200 m off, walked off, with few ranges or none, overruled."""

import pickle
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf

import numpy as np
import pytest

from bench.integrity_flights import DENIED, FAULTY, LOST_AT_S, STEP_S, Flight, Scenario, error_and_bound_m, fresh_engine
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import NoEstimate
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, GlobalPosition, GpsReceiver, Heartbeat, Inbound, PeerRange, TimeBase
from gcs_coloc.core.messages.outbound import GpsInput, HealthChanged, Notice

BACK_S = 18.0
COUNTED = "reacquired_fix_rejected"
RIGHT = Scenario(mutual=False, returns_at_s=BACK_S)
OFF = replace(RIGHT, return_jump_m=200.0)
RECOVERED_AFTER_S = 10.2  # ten seconds from the first message of the fix on

Change = Callable[[float, Inbound], Inbound | None]


@dataclass
class Seen:
    """What came of a flight of so many steps. Times count from the receiver's return, in seconds."""

    engine: Engine
    steps: int = 0
    healthy_after_s: float = inf
    wrong_after_s: float = inf
    reasons: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    fix_types: list[int] = field(default_factory=list)


def as_it_is(_t: float, message: Inbound) -> Inbound | None:
    return message


@lru_cache
def before_the_return(scenario: Scenario, seed: int) -> bytes:
    """One draw, flown until the receiver returns: the same however it does. Pickled: read several times faster than copied."""
    flight = Flight(scenario, seed)
    return pickle.dumps((watch(flight.messages, BACK_S + STEP_S), flight), pickle.HIGHEST_PROTOCOL)


def begun(scenario: Scenario, seed: int) -> tuple[Seen, Flight]:
    """One draw at the moment before its receiver returns."""
    as_any_returns = replace(scenario, returns_at_s=BACK_S, return_jump_m=0.0, return_walk_mps=0.0)
    seen, flight = pickle.loads(before_the_return(as_any_returns, seed))
    flight.scenario = scenario
    return seen, flight


def fly(scenario: Scenario, seed: int, lasts_s: float, change: Change | None = None, until_honest_s: float = inf) -> Seen:
    """Fly one draw until so long after the return; each message goes through `change`, None: it is lost."""
    seen, flight = begun(scenario, seed) if change is None else (None, Flight(scenario, seed))
    change = change or as_it_is

    def messages(t: float) -> Iterable[Inbound]:
        if t > BACK_S + until_honest_s:
            flight.away = np.zeros(3)
        return [m for m in (change(t, message) for message in flight.messages(t)) if m is not None]

    return watch(messages, BACK_S + lasts_s, seen)


def watch(messages: Callable[[float], Iterable[Inbound]], until_s: float, seen: Seen | None = None) -> Seen:
    """Fly until a time; `seen`: what came of the flight so far, where part of it has been flown."""
    seen = seen or Seen(fresh_engine())
    first, seen.steps = seen.steps, round(until_s / STEP_S)
    for step in range(first, seen.steps):
        t = step * STEP_S
        for message in messages(t):
            seen.engine.receive(message)
        # So that it can be aided: what it says of its own position is an echo then, and tells nothing.
        seen.engine.receive(Heartbeat(DENIED, t, Autopilot.ARDUPILOT, True, winged=True))
        seen.engine.receive(RouteReport(DENIED, t, None))
        for output in seen.engine.poll(t):
            if isinstance(output, HealthChanged) and output.sysid == DENIED and t > BACK_S and output.after == "healthy":
                seen.healthy_after_s = min(seen.healthy_after_s, t - BACK_S)
                seen.reasons.append(output.reason)
            if isinstance(output, GpsInput) and t > BACK_S + 3.0:
                seen.fix_types.append(output.fix_type)
            if isinstance(output, Notice) and output.sysid == DENIED:
                seen.told.append(output.text)
        reason = seen.engine.gps_health.reason(DENIED)
        if t > BACK_S and reason not in seen.reasons:
            seen.reasons.append(reason)
        if t > BACK_S and "its GPS is back but" in reason:
            seen.wrong_after_s = min(seen.wrong_after_s, t - BACK_S)
    return seen


@pytest.mark.parametrize(
    "scenario",
    [RIGHT, replace(RIGHT, mutual=True), replace(RIGHT, peers=2), replace(RIGHT, late_share=0.1)],
    ids=["its own ranges", "ranges among all", "two peers", "a tenth of the ranges late"],
)
def test_a_receiver_that_comes_back_right_is_believed_after_ten_seconds_as_ever(scenario):
    """Two draws of each; `python -m bench returning` flies hundreds."""
    for seed in range(2):
        seen = fly(scenario, seed, 12.0)
        assert seen.healthy_after_s == pytest.approx(RECOVERED_AFTER_S, abs=0.01)
        assert seen.engine.refused().get(COUNTED, 0) == 0


@pytest.mark.parametrize(
    "scenario",
    [OFF, replace(OFF, mutual=True), replace(OFF, peers=2), replace(OFF, return_jump_m=25.0)],
    ids=["its own ranges", "ranges among all", "two peers", "25 m off"],
)
def test_one_that_comes_back_elsewhere_is_not_believed_and_its_vehicle_stays_located(scenario):
    for seed in range(2):
        seen, flight = begun(scenario, seed)
        watch(flight.messages, BACK_S + 20.0, seen)
        assert seen.wrong_after_s < 3.0
        assert seen.healthy_after_s == inf
        assert any("its GPS is back but" in reason and "from where the ranges put it" in reason for reason in seen.reasons)
        assert seen.engine.refused()[COUNTED] == 1
        if scenario.peers > 2:
            error_m, bound_m = error_and_bound_m(seen.engine, flight, BACK_S + 20.0 - STEP_S)
            assert error_m < max(1.5 * bound_m, 6.0)
            # Aid goes on: one message at each step, all with a fix.
            assert len(seen.fix_types) > 80
            assert set(seen.fix_types) == {3}


def test_one_that_is_15_m_off_is_not_believed_because_no_alarm_is_raised():
    """Its error of 2.4 m, 1-sigma, and the receiver's own wander make it pass a test of 1 in 1,000 now and then."""
    healthy = [fly(replace(RIGHT, return_jump_m=15.0), seed, 16.0).healthy_after_s for seed in range(4)]
    assert sum(after_s < inf for after_s in healthy) <= 1
    assert min(healthy) > RECOVERED_AFTER_S + 3.0


def test_one_that_was_identified_while_it_is_drawn_off_slowly_does_not_come_back_on_the_way():
    """At 0.7 m/s it is found 19 s after it began, and named once it is off by more than a coarse receiver may be (61 s)."""
    flight = Flight(Scenario(mutual=True, lost=False, walk_mps=0.7, gps_sigma_m=2.0, range_sigma_m=2.0), 0)
    engine = fresh_engine()
    states = []
    for step in range(round(100.0 / STEP_S)):
        t = step * STEP_S
        for message in flight.messages(t):
            engine.receive(message)
        engine.poll(t)
        states.append(engine.gps_state(FAULTY).value)
    assert set(states[states.index("failed") :]) == {"failed"}


def test_a_rejected_receiver_is_believed_after_it_is_right_for_eleven_seconds():
    seen = fly(OFF, 1, 45.0, until_honest_s=20.0)
    assert seen.wrong_after_s < 3.0
    assert 20.0 + RECOVERED_AFTER_S < seen.healthy_after_s < 20.0 + RECOVERED_AFTER_S + 16.0


def test_one_that_comes_back_right_and_is_walked_off_while_it_is_watched_is_not_believed():
    seen = fly(replace(RIGHT, return_walk_mps=2.0), 1, 40.0)
    assert seen.healthy_after_s == inf
    assert any("its GPS is back but" in reason for reason in seen.reasons)


def test_an_untested_receiver_is_believed_after_the_same_time_and_the_reason_says_so():
    def without_ranges(t: float, message: Inbound) -> Inbound | None:
        return None if isinstance(message, PeerRange) and t > LOST_AT_S else message

    seen = fly(OFF, 1, 12.0, without_ranges)
    assert seen.healthy_after_s == pytest.approx(RECOVERED_AFTER_S, abs=0.01)
    assert any("nothing to hold it against" in reason for reason in seen.reasons)


def test_that_the_ranges_which_contradicted_it_have_ceased_says_nothing_for_it():
    seen, flight = begun(OFF, 1)

    def messages(t: float) -> Iterable[Inbound]:
        return (m for m in flight.messages(t) if t <= BACK_S + 5.0 or not isinstance(m, PeerRange))

    assert watch(messages, BACK_S + 60.0, seen).healthy_after_s == inf


def test_where_the_ranges_fit_it_again_an_estimate_that_was_wrong_does_not_stand_against_it():
    """Until the return all ranges are those of a place 158 m away, and the estimate is there, to 4 m as it says."""
    flight = Flight(RIGHT, 1)
    away = np.array((150.0, 50.0, 0.0))

    def from_elsewhere(t: float, message: Inbound) -> Inbound | None:
        if not isinstance(message, PeerRange) or not LOST_AT_S + 5.0 < t <= BACK_S:
            return message
        own, peer = flight.courses[DENIED].at(t)[0], flight.courses[message.peer].at(t)[0]
        more_m = float(np.linalg.norm(own + away - peer) - np.linalg.norm(own - peer))
        return replace(message, range_m=message.range_m + more_m)

    seen = fly(RIGHT, 1, 12.0, from_elsewhere)
    assert seen.healthy_after_s == pytest.approx(RECOVERED_AFTER_S, abs=0.01)


def test_ranges_that_are_all_too_long_do_not_keep_a_right_receiver_off():
    def too_long(t: float, message: Inbound) -> Inbound | None:
        is_long = isinstance(message, PeerRange) and t > LOST_AT_S + 5.0
        return replace(message, range_m=message.range_m + 30.0) if is_long else message

    assert fly(RIGHT, 0, 12.0, too_long).healthy_after_s == pytest.approx(RECOVERED_AFTER_S, abs=0.01)


def test_the_operator_is_believed_who_declares_it_healthy():
    seen, flight = begun(OFF, 1)

    def messages(t: float) -> Iterable[Inbound]:
        yield from flight.messages(t)
        if round(t / STEP_S) == round((BACK_S + 5.0) / STEP_S):
            yield OperatorCommand(DENIED, t, GpsOverride.HEALTHY)

    watch(messages, BACK_S + 8.0, seen)
    assert seen.wrong_after_s < 3.0
    assert seen.healthy_after_s == pytest.approx(5.0, abs=0.3)
    assert seen.engine.gps_health.reason(DENIED) == "declared healthy by the operator"


def test_a_reflected_estimate_gives_way_to_a_receiver_that_fits_the_ranges():
    """A spoofer puts the vehicle at its reflection in the line of two peers, where all ranges fit; all fly straight on."""
    origin, rng = LocalFrame(47.0, 8.0, 400.0), np.random.default_rng(1)

    def messages(t: float) -> Iterable[Inbound]:
        priors = {
            1: np.array((20.0 * t, 0.0, 100.0)),
            2: np.array((20.0 * t + 400.0, 0.0, 120.0)),
            DENIED: np.array((20.0 * t + 200.0, 150.0, 110.0)),
        }
        for sysid, place in priors.items():
            mirrored = np.array((1.0, -1.0, 1.0)) if sysid == DENIED and t < 10.0 else np.ones(3)
            lat, lon, alt = origin.geodetic_from_enu(*(float(x) for x in mirrored * place + rng.normal(0.0, 0.5, 3)))
            lost = sysid == DENIED and 10.0 < t <= BACK_S
            yield GpsReceiver(sysid, t, 0, 1 if lost else 3, lat, lon, alt, 12, 0.9, 1.5, 1.5, 0.2, t)
            yield GlobalPosition(sysid, t, t, lat, lon, alt, 0.0, 20.0, 0.0)
        for peer in (1, 2):
            range_m = float(np.linalg.norm(priors[DENIED] - priors[peer]) + rng.normal(0.0, 1.0))
            yield PeerRange(DENIED, t, peer, range_m, 1.0, t, TimeBase.BOOT, None, None, 0)

    seen = watch(messages, BACK_S)
    assert seen.engine.estimate(DENIED, BACK_S).position_enu_m[1] == pytest.approx(-150.0, abs=5.0)
    watch(messages, BACK_S + 5.0, seen)
    assert isinstance(seen.engine.estimate(DENIED, BACK_S + 5.0), NoEstimate)
    assert any("fits the ranges, our position did not" in text for text in seen.told)
    assert watch(messages, BACK_S + 12.0, seen).healthy_after_s == pytest.approx(RECOVERED_AFTER_S, abs=0.01)


def test_no_position_of_a_receiver_that_is_back_is_evidence_before_its_vehicle_is_healthy():
    seen = fly(RIGHT, 1, 9.0)
    assert seen.engine.gps_state(DENIED).value == "recovering"
    never = fly(replace(RIGHT, returns_at_s=inf), 1, 9.0)
    assert seen.engine.estimator.counts() == never.engine.estimator.counts()


JUMPS = Scenario(peers=5, mutual=False, jump_m=200.0)
"""Peer 1 steps by 200 m at 20 s and says no more; only the denied vehicle, lost at 5 s, ranges it."""


def states_of_peers(
    right_from_s: float, until_s: float, scenario: Scenario = JUMPS, receiver_each: int = 1
) -> list[tuple[float, int, str]]:
    """Fly until a time with peer 1 off up to a time; the changes of the peers' states once all are healthy.

    Once it is off, each n-th message of its receiver arrives.
    """
    flight, engine = Flight(scenario, 0, right_from_s), fresh_engine()
    seen: list[tuple[float, int, str]] = []
    for step in range(round(until_s / STEP_S)):
        t = step * STEP_S
        for message in flight.messages(t):
            if t < 20.0 or step % receiver_each == 0 or message.sysid != FAULTY or not isinstance(message, GpsReceiver):
                engine.receive(message)
        changes = (output for output in engine.poll(t) if isinstance(output, HealthChanged))
        seen += [(round(t, 1), c.sysid, c.after) for c in changes if c.sysid != DENIED and t > LOST_AT_S]
    return seen


def test_a_peer_that_has_jumped_is_not_believed_again_while_the_denied_vehicles_ranges_contradict_it():
    """Believed again as soon as its autopilot was content, it made all five peers suspect, and there was no fix."""
    assert states_of_peers(inf, 50.0) == [(21.2, FAULTY, "suspect")]


def test_a_receiver_that_is_heard_each_second_and_a_bit_is_tested_on_where_it_was_before():
    """Of a real plane on a radio of 1 Hz the tests began anew each second: it was believed again while it was 60 m off."""
    assert states_of_peers(inf, 60.0, receiver_each=6) == [(21.2, FAULTY, "suspect")]


def test_one_that_has_jumped_back_is_believed_again():
    """Ten seconds after its jump back, as without ranges, and the ranges have contradicted it for less."""
    assert states_of_peers(30.0, 50.0) == [(21.2, FAULTY, "suspect"), (44.8, FAULTY, "healthy")]


@pytest.mark.parametrize("peers", [3, 5])
def test_one_that_witnesses_range_in_every_direction_is_held_no_longer_than_any_receiver(peers):
    """What a denied vehicle's range has contradicted for 30 s held it for 20 to 30 s, though ranges among all had tested it."""
    jumps = replace(JUMPS, peers=peers, mutual=True, jump_m=60.0)
    seen = states_of_peers(50.0, 65.0, jumps)
    assert [(vehicle, after) for _, vehicle, after in seen] == [
        (FAULTY, "suspect"),
        (FAULTY, "failed"),
        (FAULTY, "recovering"),
        (FAULTY, "healthy"),
    ]
    right_again_s, believed_s = seen[2][0], seen[3][0]
    assert right_again_s - 50.0 < 5.0
    assert believed_s - 50.0 < 15.0
