"""The GPS health machine: each transition, with the evidence that causes it and the reason that is told."""

from dataclasses import replace

import pytest

from gcs_coloc.core.gps_health.evidence import FaultReason, GpsEvidence, GpsReason, PositionFault
from gcs_coloc.core.gps_health.gps_health import GpsHealth, GpsHealthSettings, GpsState
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.messages.inbound import EkfStatus, GpsReceiver, SystemHealth
from gcs_coloc.core.reasons import StatedReason


def receiver(at_s: float, fix_type: int = 3, satellites: int | None = 10, h_acc_m: float | None = 1.0) -> GpsReceiver:
    return GpsReceiver(1, at_s, 0, fix_type, 47.0, 8.0, 500.0, satellites, 1.0, h_acc_m, 1.5, 0.3)


class Machine:
    """A state machine with the evidence that it was given last."""

    def __init__(self) -> None:
        self.health = GpsHealth(GpsHealthSettings())
        self.evidence = GpsEvidence()

    @property
    def state(self) -> GpsState:
        return self.health.state

    @property
    def reason(self) -> str:
        return self.health.reason.text

    def add(self, message: GpsReceiver | SystemHealth | EkfStatus) -> None:
        if isinstance(message, GpsReceiver):
            self.health.add_receiver(message, None)
            self.know(receiver=message)
        elif isinstance(message, SystemHealth):
            self.know(system=message)
        else:
            self.know(ekf=message)

    def know(self, **evidence: object) -> None:
        self.evidence = replace(self.evidence, **evidence)

    def update(self, now_s: float) -> None:
        self.health.update(self.evidence, now_s)


def healthy_until(t_s: float) -> Machine:
    health = Machine()
    run(health, 0.0, t_s)
    assert health.state is GpsState.HEALTHY
    return health


def run(health: Machine, start_s: float, stop_s: float, **fix: object) -> None:
    for i in range(int((stop_s - start_s) * 5) + 1):
        health.add(receiver(start_s + i / 5, **fix))
        health.update(start_s + i / 5)


def test_a_vehicle_that_had_no_fix_from_the_first_message_on_is_failed_at_once():
    """So it is after a restart of the service in a loss: it has waited for its position long enough."""
    health = Machine()
    run(health, 0.0, 0.0, fix_type=1)
    assert health.state is GpsState.FAILED
    assert "no 3D fix" in health.reason


def test_a_vehicle_whose_ekf_is_heard_before_its_receiver_without_a_fix_is_failed_with_that():
    health = Machine()
    health.add(EkfStatus(1, 0.0, False, False, True))
    health.update(0.0)
    assert health.state is GpsState.SUSPECT
    run(health, 0.1, 0.1, fix_type=1)
    assert health.state is GpsState.FAILED


def test_nothing_heard_is_unknown():
    health = Machine()
    health.update(100.0)
    assert health.state is GpsState.UNKNOWN


@pytest.mark.parametrize(
    ("fix", "words"),
    [({"fix_type": 1}, "fix type 1"), ({"satellites": 3}, "3 satellites"), ({"h_acc_m": 80.0}, "accuracy 80 m")],
)
def test_a_lost_fix_is_suspect_at_once_and_failed_after_a_second(fix, words):
    health = healthy_until(5.0)
    run(health, 5.2, 5.2, **fix)
    assert health.state is GpsState.SUSPECT
    run(health, 5.4, 6.4, **fix)
    assert health.state is GpsState.FAILED
    assert words in health.reason


UNHEALTHY, HEALTHY_SYSTEM = (True, True, False), (True, True, True)


@pytest.mark.parametrize(
    ("system", "absolute", "after"),
    [
        (UNHEALTHY, None, GpsState.FAILED),
        (None, False, GpsState.FAILED),
        (HEALTHY_SYSTEM, True, GpsState.SUSPECT),
        (None, None, GpsState.SUSPECT),
    ],
)
def test_a_receiver_that_falls_silent_is_lost_where_the_vehicle_says_so_otherwise_and_suspect_where_it_does_not(
    system, absolute, after
):
    """Older PX4 sends no GPS_RAW_INT without a receiver; a poor link loses it while the receiver is sound."""
    health = healthy_until(5.0)
    for i in range(1, 100):
        t = 5.0 + i / 10
        if system is not None:
            health.add(SystemHealth(1, t, *system))
        if absolute is not None:
            health.add(EkfStatus(1, t, absolute, False, False))
        health.update(t)
    assert health.state is after


def test_a_receiver_that_its_autopilot_vouches_for_is_heard_again_in_time():
    """Radios of real copters lose GPS_RAW_INT for 3 to 9 s while SYS_STATUS comes now and then."""
    health = healthy_until(5.0)
    for i in range(1, 85):
        if i % 20 == 0:
            health.add(SystemHealth(1, 5.0 + i / 10, *HEALTHY_SYSTEM))
        health.update(5.0 + i / 10)
        assert health.state is GpsState.HEALTHY
    aided = healthy_until(5.0)
    aided.know(is_aided=True)
    for i in range(1, 35):
        aided.add(SystemHealth(1, 5.0 + i / 10, *HEALTHY_SYSTEM))
        aided.update(5.0 + i / 10)
    assert aided.state is GpsState.SUSPECT, "what an autopilot says that flies on our fix is an echo"


@pytest.mark.parametrize(("fix_type", "after"), [(3, GpsState.HEALTHY), (1, GpsState.SUSPECT)])
def test_a_receiver_of_which_only_silence_was_held_is_believed_with_its_next_good_report(fix_type, after):
    health = healthy_until(5.0)
    health.update(8.1)
    assert health.state is GpsState.SUSPECT
    health.add(receiver(9.0, fix_type=fix_type))
    health.update(9.0)
    assert health.state is after
    health.add(receiver(9.2))
    health.update(9.2)
    assert health.state is after, "a flickering fix is watched, silence before it or not"


def test_a_receiver_on_its_way_back_is_not_lost_by_a_gap_of_the_link_but_by_a_long_one():
    health = healthy_until(5.0)
    for i in range(100):
        t = 5.0 + i / 5
        health.add(receiver(t, fix_type=1 if t < 10.0 else 3))
        health.update(t)
        if health.state is GpsState.RECOVERING:
            break
    for i in range(1, 80):
        health.update(t + i / 10)
        assert health.state is GpsState.RECOVERING
    for i in range(30):
        health.add(receiver(t + 8.0 + i / 5))
        health.update(t + 8.0 + i / 5)
        assert health.state is GpsState.RECOVERING, "it is watched from the gap on"
    for i in range(200):
        health.update(t + 16.0 + i / 10)
    assert health.state is GpsState.FAILED
    assert "no GPS_RAW_INT" in health.reason


def test_what_was_said_before_a_receiver_fell_silent_does_not_make_it_lost():
    health = healthy_until(5.0)
    health.add(SystemHealth(1, 4.9, *UNHEALTHY))
    for i in range(1, 200):
        health.update(5.0 + i / 10)
    assert health.state is GpsState.SUSPECT


def before_take_off_until(t_s: float) -> Machine:
    """A sound receiver of an autopilot whose EKF has no absolute position yet, as before a take-off."""
    health = healthy_until(5.0)
    for i in range(1, round((t_s - 5.0) * 5.0) + 1):
        t = 5.0 + i / 5
        health.add(receiver(t))
        health.add(EkfStatus(1, t, False, False, False))
        health.update(t)
    assert health.state is GpsState.SUSPECT
    return health


def test_a_poor_link_does_not_make_a_receiver_lost_that_the_filter_does_not_use_yet():
    """Real copters before their take-off, by telemetry radios: gaps of 3 to 13 s, and four reports in a row that were lost."""
    health = before_take_off_until(20.0)
    for i in range(150):
        t = 33.0 + i / 10
        if i % 10 == 0:
            health.add(EkfStatus(1, t, False, False, False))
        if i % 50 == 30:
            health.add(receiver(t))
        health.update(t)
        assert health.state is GpsState.SUSPECT


def test_a_receiver_that_the_filter_did_not_use_is_lost_once_the_vehicle_was_heard_without_it_for_ten_seconds():
    health = before_take_off_until(20.0)
    failed_s = None
    for i in range(1, 200):
        t = 20.0 + i / 10
        if i % 10 == 0:
            health.add(EkfStatus(1, t, False, False, False))
        health.update(t)
        failed_s = t if failed_s is None and health.state is GpsState.FAILED else failed_s
    assert failed_s == pytest.approx(30.0, abs=1.0)


def test_a_short_dropout_clears_after_two_seconds():
    health = healthy_until(5.0)
    run(health, 5.2, 5.4, fix_type=1)
    run(health, 5.6, 7.4)
    assert health.state is GpsState.SUSPECT
    run(health, 7.6, 8.0)
    assert health.state is GpsState.HEALTHY


def test_a_jammed_receivers_flicker_fails_it_and_keeps_it_failed():
    health = healthy_until(5.0)
    states = set()
    for i in range(100):
        t = 5.2 + i / 5
        health.add(receiver(t, fix_type=6 if i % 4 < 2 else 1))
        health.update(t)
        if t > 8.0:
            states.add(health.state)
    assert GpsState.HEALTHY not in states
    assert GpsState.FAILED in states


def test_recovery_takes_ten_good_seconds():
    health = healthy_until(5.0)
    run(health, 5.2, 8.0, fix_type=1)
    run(health, 8.2, 18.0)
    assert health.state is GpsState.RECOVERING
    run(health, 18.2, 18.6)
    assert health.state is GpsState.HEALTHY


def test_recovery_starts_anew_after_each_relapse():
    health = healthy_until(5.0)
    run(health, 5.2, 8.0, fix_type=1)
    run(health, 8.2, 17.0)
    run(health, 17.2, 17.2, fix_type=1)
    assert health.state is GpsState.FAILED
    run(health, 17.4, 26.0)
    assert health.state is GpsState.RECOVERING


def test_a_silent_receiver_is_suspect_but_not_failed():
    health = healthy_until(5.0)
    health.update(8.1)
    assert health.state is GpsState.SUSPECT
    assert "no GPS_RAW_INT" in health.reason
    health.update(60.0)
    assert health.state is GpsState.SUSPECT


@pytest.mark.parametrize(
    "evidence",
    [
        SystemHealth(1, 5.0, True, True, False),
        EkfStatus(1, 5.0, True, False, True),
        EkfStatus(1, 5.0, True, True, False),
        EkfStatus(1, 5.0, False, False, False),
    ],
)
def test_an_autopilot_that_reports_trouble_is_suspect_unless_that_is_an_echo_of_our_aid(evidence):
    health = healthy_until(5.0)
    health.add(evidence)
    health.update(5.1)
    assert health.state is GpsState.SUSPECT
    aided = healthy_until(5.0)
    aided.know(is_aided=True)
    aided.add(evidence)
    aided.update(5.1)
    assert aided.state is GpsState.HEALTHY


def test_the_operators_word_wins_until_withdrawn():
    health = healthy_until(5.0)
    health.know(override=GpsOverride.FAILED)
    run(health, 5.2, 6.0)
    assert health.state is GpsState.FAILED
    assert "operator" in health.reason
    health.know(override=GpsOverride.HEALTHY)
    run(health, 6.2, 10.0, fix_type=0)
    assert health.state is GpsState.HEALTHY
    health.know(override=GpsOverride.AUTO)
    run(health, 10.2, 12.0, fix_type=0)
    assert health.state is GpsState.FAILED


def test_a_receiver_frozen_on_the_move_fails_and_a_jump_is_suspect():
    frozen, jumped = healthy_until(5.0), healthy_until(5.0)
    for i in range(60):
        t = 5.2 + i / 5
        for health, east_m in ((frozen, 20.0 * t), (jumped, 20.0 * t + (40.0 if t > 8.0 else 0.0))):
            health.health.add_position(
                PositionMeasurement(1, t, t, (east_m, 0.0, 0.0), 1.0, 2.0, (20.0, 0.0, 0.0), 0.3), own=True
            )
        frozen.add(receiver(t))
        jumped.add(replace(receiver(t), lat_deg=47.0 + 1e-5 * i))
        frozen.update(t)
        jumped.update(t)
    assert frozen.state is GpsState.FAILED
    assert "repeats one position" in frozen.reason
    assert jumped.state is GpsState.SUSPECT
    assert "other than its velocity" in jumped.reason


def test_a_silence_that_is_over_has_shown_nothing_against_a_receiver_that_was_in_question():
    """While it was silent, its ranges alone went on: to hold them against it makes one faulty device a faulty receiver."""
    machine = healthy_until(5.0)
    machine.know(contradiction=PositionFault(FaultReason.NOT_ISOLATED))
    run(machine, 5.2, 6.0)
    for step in range(30):
        machine.update(6.0 + step / 5)
    machine.know(contradiction=None)
    assert machine.health.reason.reason is GpsReason.SILENT
    assert not machine.health.may_witness
    run(machine, 12.0, 12.2)
    assert machine.state is GpsState.SUSPECT
    assert machine.health.may_witness


def test_a_height_that_is_set_before_the_ekf_has_a_place_makes_no_suspect_after_it():
    machine = Machine()
    for step in range(150):
        t = step / 5
        up_m = 450.0 if t >= 10.0 else 0.0
        machine.health.add_position(PositionMeasurement(1, t, t, (0.0, 0.0, up_m), 1.0, 2.0, (0.0, 0.0, 0.1), 0.3), own=True)
        machine.add(receiver(t, fix_type=3 if t >= 9.0 else 1))
        machine.add(EkfStatus(1, t, t >= 20.0, False, False))
        machine.update(t)
        assert machine.health.reason.reason is not GpsReason.IMPLAUSIBLE_MOTION
    assert machine.state in (GpsState.RECOVERING, GpsState.HEALTHY)


def test_an_identified_contradiction_fails_at_once_and_an_unclear_one_is_suspect():
    identified, among = healthy_until(5.0), healthy_until(5.0)
    identified.know(contradiction=PositionFault(FaultReason.CONTRADICTS_RANGES))
    among.know(contradiction=PositionFault(FaultReason.NOT_ISOLATED))
    run(identified, 5.2, 5.2)
    run(among, 5.2, 30.0)
    assert identified.state is GpsState.FAILED
    assert among.state is GpsState.SUSPECT


@pytest.mark.parametrize("reason", GpsReason)
def test_every_reason_is_worded(reason):
    text = StatedReason(reason, 1.0, 2.0, "a detail").text
    assert text
    assert "{" not in text


def test_a_fix_that_flickers_is_neither_recovering_nor_healthy():
    """As under jamming: a fix for 0.8 s, then none for 0.4 s, for a minute."""
    health = healthy_until(5.0)
    run(health, 5.2, 8.0, fix_type=1)
    states = []
    for i in range(50):
        at_s = 8.2 + 1.2 * i
        run(health, at_s, at_s + 0.6)
        states.append(health.state)
        run(health, at_s + 0.8, at_s + 1.0, fix_type=1)
        states.append(health.state)
    assert set(states) == {GpsState.FAILED}
    assert health.health.reports_false_fix
    run(health, 70.0, 79.8)
    assert health.state is GpsState.RECOVERING
    run(health, 80.0, 80.2)
    assert health.state is GpsState.HEALTHY


def test_a_glitch_that_the_ekf_still_reports_after_it_flew_on_our_fix_is_an_echo():
    """EKF3 forgets the worst speed accuracy that it was sent with a time constant of 10 s."""
    health = healthy_until(5.0)
    glitch = EkfStatus(1, 5.0, horizontal_position_absolute=True, constant_position_mode=False, gps_glitching=True)
    health.know(is_aided=True, ekf=glitch)
    run(health, 5.0, 10.0)
    health.know(is_aided=False)
    run(health, 10.2, 21.8)
    assert health.state is GpsState.HEALTHY
    run(health, 22.2, 22.4)
    assert (health.state, health.reason) == (GpsState.SUSPECT, "the autopilot's EKF reports a GPS glitch")


def test_a_suspect_receiver_that_ranges_contradict_is_not_believed_for_want_of_other_trouble():
    health = healthy_until(5.0)
    glitch = EkfStatus(1, 5.0, horizontal_position_absolute=True, constant_position_mode=False, gps_glitching=True)
    health.know(ekf=glitch, is_return_contradicted=True)
    run(health, 5.2, 8.0)
    health.know(ekf=replace(glitch, gps_glitching=False))
    run(health, 8.2, 20.0)
    assert health.state is GpsState.SUSPECT
    assert "back, but ranges to it do not fit" in health.reason
    health.know(is_return_contradicted=False)
    run(health, 20.2, 20.4)
    assert health.state is GpsState.HEALTHY


def test_after_each_relapse_a_fix_must_be_steady_for_twice_as_long():
    """A fix that comes for five seconds at a time is recovering once and never again."""
    health = healthy_until(5.0)
    run(health, 5.2, 8.0, fix_type=1)
    changes = 0
    for i in range(20):
        at_s = 8.2 + 6.0 * i
        for part, fix in ((0.0, 3), (5.0, 1)):
            before = health.state
            run(health, at_s + part, at_s + part + (4.8 if part == 0.0 else 0.8), fix_type=fix)
            changes += health.state is not before
    assert changes == 2
    assert health.state is GpsState.FAILED


def test_a_receiver_that_flickers_for_half_a_day_must_be_steady_for_no_longer_than_30_s():
    health = healthy_until(5.0)
    at_s = 10.0
    for _ in range(1100):
        health.add(receiver(at_s, fix_type=1))
        health.update(at_s)
        health.update(at_s + 1.0)
        for good_for_s in (2.0, 32.0):
            health.add(receiver(at_s + good_for_s))
            health.update(at_s + good_for_s)
        assert health.state is GpsState.RECOVERING
        at_s += 35.0
    assert at_s < 12 * 3600.0


def test_a_receiver_that_comes_back_reports_no_false_fix():
    """It is watched; GPS_PRIMARY is not to be taken from it."""
    health = healthy_until(5.0)
    run(health, 5.2, 20.0, fix_type=1)
    for i in range(14):
        run(health, 20.2 + i / 5, 20.2 + i / 5)
        assert not health.health.reports_false_fix
    assert health.state is GpsState.FAILED
    run(health, 23.2, 23.4)
    assert health.state is GpsState.RECOVERING


def test_a_service_that_runs_late_accuses_nobody_of_its_own_silence():
    late, in_time = healthy_until(5.0), healthy_until(5.0)
    late.know(host_lag_s=2.0)
    for health in (late, in_time):
        health.update(9.0)
    assert late.state is GpsState.HEALTHY
    assert in_time.state is GpsState.SUSPECT
    late.update(10.2)
    assert late.state is GpsState.SUSPECT


def test_a_host_that_keeps_up_as_well_as_hosts_do_excuses_nothing():
    """It is some hundredths of a second late every second; the contradiction stands for as long as the fault does."""
    health = healthy_until(5.0)
    health.know(host_lag_s=0.03, contradiction=PositionFault(FaultReason.NOT_ISOLATED))
    run(health, 5.2, 5.2)
    assert health.state is GpsState.SUSPECT


def test_while_the_service_runs_late_a_contradiction_counts_only_where_it_names_the_vehicle():
    unclear, named = healthy_until(5.0), healthy_until(5.0)
    for health, reason in ((unclear, FaultReason.NOT_ISOLATED), (named, FaultReason.CONTRADICTS_RANGES)):
        health.know(host_lag_s=0.5, contradiction=PositionFault(reason))
        run(health, 5.2, 6.0)
    assert unclear.state is GpsState.HEALTHY
    assert named.state is GpsState.FAILED
    unclear.know(host_lag_s=0.0)
    run(unclear, 6.2, 6.4)
    assert unclear.state is GpsState.SUSPECT
