"""What a receiver says of interference with it is evidence of its vehicle's GPS health."""

import pytest

from gcs_coloc.core.gps_health.evidence import GpsEvidence
from gcs_coloc.core.gps_health.gps_health import GpsHealth, GpsHealthSettings, GpsState
from gcs_coloc.core.messages.inbound import GpsReceiver, Interference, ReceiverIntegrity


def integrity(at_s: float, **found: object) -> ReceiverIntegrity:
    said = {"jamming": Interference.UNKNOWN, "spoofing": Interference.UNKNOWN, "raim_failed": False}
    return ReceiverIntegrity(1, at_s, 0, **(said | found))


def fly(health: GpsHealth, start_s: float, stop_s: float, *, fix_type: int = 3, said_at_s: float | None = None, **found) -> None:
    """A receiver's fix five times a second beside what it says of itself: all the time, or once at `said_at_s`."""
    for i in range(round((stop_s - start_s) * 5) + 1):
        now_s = start_s + i / 5
        fix = GpsReceiver(1, now_s, 0, fix_type, 47.0, 8.0, 500.0, 10, 1.0, 1.0, 1.5, 0.3)
        health.add_receiver(fix, None)
        health.update(GpsEvidence(receiver=fix, integrity=integrity(now_s if said_at_s is None else said_at_s, **found)), now_s)


@pytest.fixture
def health() -> GpsHealth:
    machine = GpsHealth(GpsHealthSettings())
    fly(machine, 0.0, 5.0)
    assert machine.state is GpsState.HEALTHY
    return machine


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"spoofing": Interference.DETECTED}, "reports spoofing"),
        ({"spoofing": Interference.MITIGATED}, "signs of spoofing"),
        ({"jamming": Interference.DETECTED}, "reports jamming"),
        ({"raim_failed": True}, "RAIM"),
    ],
)
def test_what_the_receiver_notices_makes_it_suspect_with_the_reason_but_not_failed_while_it_has_a_fix(health, found, words):
    fly(health, 5.2, 5.2, **found)
    assert health.state is GpsState.SUSPECT
    assert words in health.reason.text
    fly(health, 5.4, 25.0, **found)
    assert health.state is GpsState.SUSPECT
    assert not health.may_witness


def test_it_is_believed_again_when_the_receiver_has_noticed_nothing_for_a_while(health):
    fly(health, 5.2, 8.0, spoofing=Interference.DETECTED)
    fly(health, 8.2, 9.8, spoofing=Interference.NONE)
    assert health.state is GpsState.SUSPECT
    fly(health, 10.0, 10.4, spoofing=Interference.NONE)
    assert health.state is GpsState.HEALTHY


def test_jamming_that_the_receiver_mitigates_is_no_fault_and_is_shown(health):
    fly(health, 5.2, 8.0, jamming=Interference.MITIGATED)
    assert health.state is GpsState.HEALTHY
    assert "jamming mitigated" in health.reason.text


def test_a_lost_fix_is_failed_with_its_own_reason_whatever_else_the_receiver_says(health):
    fly(health, 5.2, 7.0, fix_type=1, jamming=Interference.DETECTED)
    assert health.state is GpsState.FAILED
    assert "no 3D fix" in health.reason.text


def test_what_it_said_long_ago_is_no_evidence(health):
    fly(health, 5.2, 9.8, said_at_s=5.0, spoofing=Interference.DETECTED)
    assert health.state is GpsState.SUSPECT
    fly(health, 10.2, 12.4, said_at_s=5.0, spoofing=Interference.DETECTED)
    assert health.state is GpsState.HEALTHY
