"""Two real services at vehicles with two radios: one sends, and the other takes over when it is killed, stopped or ended."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator

import pytest
from brokers import wait_until

from bench.two_links import COMPONENT_IDS, Pair, TwoLinks, changes, two_links
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration

FIRST, SECOND = COMPONENT_IDS
PATIENCE_S = 60.0


@pytest.fixture
def air_and_pair(tmp_path) -> Iterator[tuple[TwoLinks, Pair]]:
    with two_links() as (air, ports):
        pair = Pair(air, ports, tmp_path, "--no-web")
        yield air, pair
        pair.end()


def started(air: TwoLinks, pair: Pair, *arguments: str) -> None:
    """Both services run, the first one sends, and the vehicles are in the air."""
    pair.start(0, *arguments)
    pair.start(1)
    # Nothing flies yet: time in which a service stands still is none in which it has listened, and on a busy machine, with a
    # fleet to keep up with, that was a minute.
    wait_until(lambda: "sends: it is to be active" in pair.log(0) and "this service follows" in pair.log(1), PATIENCE_S)
    assert air.fly(PATIENCE_S, lambda: "vehicle 4: GPS unknown" in pair.log(1)), pair.end()
    air.fly(3.0)


def aided(air: TwoLinks, pair: Pair) -> None:
    """Both services run, and the first one feeds vehicle 4."""
    started(air, pair)
    air.lose_gps()
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(FIRST)), pair.end()
    air.fly(3.0)  # the second one has it located, too


def test_the_second_one_takes_over_from_one_that_was_killed_and_one_that_returns_is_passive(air_and_pair):
    air, pair = air_and_pair
    aided(air, pair)
    pair.processes[0].kill()
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(SECOND)), pair.end()
    pair.processes[0].wait()
    pair.start(0)
    # By a sign of life of the other one, or by a fix that a vehicle passes on: whichever it gets first.
    passive = "this service follows, and does not take over until it is told"
    assert air.fly(PATIENCE_S, lambda: passive in pair.log(0)), pair.end()
    air.fly(2.0)
    [(_, first)] = changes(air.aids())
    assert first.compid == SECOND
    assert first.fix_type == 3
    took_over = pair.end()[1]
    assert "ERROR hot standby: this service is active, it sends: the other one gave no sign of life" in took_over


def test_one_that_was_stopped_sends_nothing_when_it_goes_on(air_and_pair):
    air, pair = air_and_pair
    aided(air, pair)
    pair.processes[0].send_signal(signal.SIGSTOP)
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(SECOND)), pair.end()
    air.fly(1.0)
    pair.processes[0].send_signal(signal.SIGCONT)
    went_on_s = time.monotonic()
    air.fly(4.0)
    assert {fed.compid for fed in air.aids(went_on_s)} == {SECOND}
    assert len(changes(air.aids())) == 1
    assert "stood still for" in pair.end()[0]


def test_one_that_ends_in_order_lets_the_other_one_take_over_without_a_last_no_fix(air_and_pair):
    air, pair = air_and_pair
    aided(air, pair)
    pair.processes[0].send_signal(signal.SIGINT)
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(SECOND)), pair.end()
    assert pair.processes[0].wait(PATIENCE_S) == 0
    air.fly(1.0)
    since_s = next(fed.at_s for fed in air.aids() if fed.fix_type == 3)
    assert {fed.fix_type for fed in air.aids(since_s)} == {3}
    assert len(changes(air.aids())) == 1


def test_an_override_given_to_the_first_one_holds_after_the_take_over(air_and_pair):
    air, pair = air_and_pair
    started(air, pair, "--failed", "4")  # its GPS works: only the override has it aided
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(FIRST)), pair.end()
    assert air.fly(PATIENCE_S, lambda: "operator: GPS failed, by other service" in pair.log(1)), pair.end()
    pair.processes[0].kill()
    killed_s = time.monotonic()
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(SECOND, killed_s)), pair.end()


def test_what_the_second_one_records_holds_nothing_that_it_did_not_send(air_and_pair, tmp_path):
    air, pair = air_and_pair
    pair.start(0)
    pair.start(1, "--record", str(tmp_path / "recording"))
    air.fly(5.0)
    air.lose_gps()
    assert air.fly(PATIENCE_S, lambda: air.has_fix_from(FIRST)), pair.end()
    air.fly(2.0)
    pair.processes[1].send_signal(signal.SIGINT)
    assert pair.processes[1].wait(PATIENCE_S) == 0
    (tlog,) = (tmp_path / "recording").glob("*.tlog")
    sent = [record for record in TlogReader(tlog) if record.frame[5:7] == bytes((254, SECOND)) and record.frame[7] == 232]
    assert sent == []
    assert {fed.compid for fed in air.aids()} == {FIRST}
