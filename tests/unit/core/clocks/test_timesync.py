"""Clock offsets from TIMESYNC by hand-moved time: jitter, drift, reboots, forgeries, and what is said without an answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gcs_coloc.core.clocks.sender_clock import SenderClock
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings, VehicleClock
from gcs_coloc.core.reasons import CoreRefusal

Delay = Callable[[np.random.Generator], float]
UNIFORM: Delay = lambda rng: float(rng.uniform(0.05, 0.4))  # noqa: E731
BELL: Delay = lambda rng: min(max(float(rng.normal(0.225, 0.05)), 0.05), 0.4)  # noqa: E731
QUEUE: Delay = lambda rng: float(min(0.05 + rng.exponential(0.05), 0.4))  # noqa: E731
SETTINGS = TimeSettings()


class Exchange:
    """A vehicle's clock behind a jittered link: telemetry at 10 Hz, TIMESYNC as the engine asks for it."""

    def __init__(self, seed: int, offset_s: float, drift: float, down: Delay, up: Delay | None) -> None:
        self.rng = np.random.default_rng(seed)
        self.offset_s, self.drift, self.down, self.up = offset_s, drift, down, up
        self.clock = VehicleClock()
        self.refused: list[str] = []
        self.asked = 0
        self.stamps_refused = 0

    def boot_s(self, at_s: float) -> float:
        return (at_s + self.offset_s) * (1.0 + self.drift)

    def run(self, start_s: float, stop_s: float) -> None:
        stamps = [(at_s + self.down(self.rng), self.boot_s(at_s)) for at_s in np.arange(start_s, stop_s, 0.1).tolist()]
        under_way: list[tuple[float, int, float]] = []
        polls = iter(np.arange(start_s, stop_s, 0.2).tolist())
        poll_s = next(polls, None)
        for received_s, stamp_s in sorted(stamps):
            while poll_s is not None and poll_s <= received_s:
                ts1 = self.clock.round_trips.request(7, poll_s, SETTINGS.timesync_period_s)
                self.asked += ts1 is not None
                if ts1 is not None and self.up is not None:
                    there_s = poll_s + self.up(self.rng)
                    under_way.append((there_s + self.down(self.rng), ts1, self.boot_s(there_s)))
                poll_s = next(polls, None)
            for answer in sorted(a for a in under_way if a[0] <= received_s):
                under_way.remove(answer)
                self.answer(answer[1], answer[2], answer[0])
            self.stamps_refused += not self.clock.learn(stamp_s, received_s)

    def answer(self, ts1: int, tc1_s: float, received_s: float) -> None:
        refusal = self.clock.add_answer(ts1, tc1_s, received_s)
        if refusal is not None:
            self.refused.append(refusal)

    def error_s(self, at_s: float) -> float:
        return self.clock.to_service(self.boot_s(at_s), at_s).at_s - at_s


@pytest.mark.parametrize("drift", [-20e-6, 0.0, 20e-6])
@pytest.mark.parametrize("delay", [UNIFORM, BELL, QUEUE], ids=["uniform", "bell", "queue"])
def test_the_offset_is_within_5_ms_on_a_link_with_50_to_400_ms_of_jitter(delay, drift):
    errors, scaled = [], []
    for seed in range(6):
        vehicle = Exchange(seed, (-2.0, 2.0, 1000.0)[seed % 3] + 10.0, drift, delay, delay)
        vehicle.run(0.0, 400.0)
        assert (vehicle.clock.resets, vehicle.stamps_refused) == (0, 0)
        errors.append(vehicle.error_s(400.0))
        scaled.append(errors[-1] / vehicle.clock.to_service(vehicle.boot_s(400.0), 400.0).sigma_s)
    # Least of 300 uniform delays each way: (Exp(1.2 ms) - Exp(1.2 ms)) / 2 goes beyond 5 ms once in 5,000; queue: far
    # below; drift adds half a millisecond. Bell: the mean of 300 has 50 ms / sqrt(2 x 300) = 2 ms, and where delays have no
    # sharp end most of the drift stays unseen: 20e-6 over half of 300 s, 3 ms. Band: 3 sigma of both.
    limit = 11 if delay is BELL else 5
    assert np.max(np.abs(errors)) < limit * 1e-3
    assert np.max(np.abs(scaled)) < 3.0


def test_the_first_answers_are_bounded_by_causality_and_said_to_be():
    for seed in range(20):
        vehicle = Exchange(seed, 500.0, 0.0, UNIFORM, UNIFORM)
        vehicle.run(0.0, 2.0)
        sync = vehicle.clock.synchronised(2.0)
        assert sync is not None
        error_s = sync.offset_at_s(2.0) - (2.0 - vehicle.boot_s(2.0))
        assert abs(error_s) <= sync.one_way_delay_s + 1e-9
        assert abs(error_s) < 4.0 * sync.sigma_s


def test_the_one_way_delay_is_the_least_of_the_link():
    vehicle = Exchange(1, 0.0, 0.0, QUEUE, QUEUE)
    vehicle.run(0.0, 120.0)
    assert vehicle.clock.one_way_delay_s(120.0) == pytest.approx(0.05, abs=0.005)


def test_without_answers_the_error_is_the_least_delay_and_its_sigma_is_at_least_the_settings():
    vehicle = Exchange(2, 2.0, 20e-6, UNIFORM, None)
    vehicle.run(0.0, 120.0)
    assert vehicle.clock.synchronised(120.0) is None
    assert vehicle.clock.one_way_delay_s(120.0) is None
    assert vehicle.error_s(120.0) == pytest.approx(0.05, abs=0.005)
    assert vehicle.clock.to_service(vehicle.boot_s(120.0), 120.0).sigma_s == 0.25
    vehicle.clock.settings = TimeSettings(min_delay_s=0.05, min_delay_sigma_s=0.01)
    known = vehicle.clock.to_service(vehicle.boot_s(120.0), 120.0)
    assert known.at_s == pytest.approx(120.0, abs=0.005)
    assert known.sigma_s == 0.01


@pytest.mark.parametrize(
    ("mean_wait_s", "sigma_s", "drift"),
    [(0.001, 0.05, 0.0), (0.01, 0.064, 20e-6), (0.03, 0.13, -20e-6), (0.2, 0.25, 0.0), (0.001, 0.05, -0.01), (0.001, 0.05, 0.01)],
)
def test_the_longer_messages_wait_on_a_link_the_less_is_known_of_its_least_delay(mean_wait_s, sigma_s, drift):
    vehicle = Exchange(1, 5.0, drift, lambda rng: 0.05 + rng.exponential(mean_wait_s), None)
    vehicle.run(0.0, 120.0)
    assert vehicle.clock.quality(120.0) == ("one-way", pytest.approx(sigma_s, rel=0.1))


@pytest.mark.parametrize("utc_behind_s", [0.05, 0.15, 0.3])
@pytest.mark.parametrize("least_s", [0.02, 0.3, 0.7])
def test_the_utc_of_a_vehicle_shows_how_late_its_link_is(least_s, utc_behind_s):
    vehicle = Exchange(1, 5.0, 20e-6, lambda rng: least_s + rng.exponential(0.01), None)
    vehicle.run(0.0, 120.0)
    vehicle.clock.add_utc(1e9 + 120.0 - utc_behind_s, vehicle.boot_s(120.0), 1e9)
    known = vehicle.clock.to_service(vehicle.boot_s(120.0), 120.0)
    assert abs(known.at_s - 120.0) < 2.0 * known.sigma_s
    assert vehicle.clock.quality(120.0) == ("UTC", pytest.approx(0.08, abs=0.001))
    assert vehicle.clock.one_way_delay_s(120.0) == pytest.approx(least_s, abs=0.17)
    vehicle.run(120.0, 130.0)
    assert abs(vehicle.error_s(130.0)) < 0.17


@pytest.mark.parametrize("utc_behind_s", [-1.0, 1.1, 18.0, -1e6])
def test_a_utc_that_no_link_explains_shows_nothing(utc_behind_s):
    vehicle = Exchange(1, 5.0, 0.0, lambda _: 0.02, None)
    vehicle.run(0.0, 60.0)
    vehicle.clock.add_utc(1e9 + 60.0, vehicle.boot_s(60.0), 1e9)
    assert vehicle.clock.quality(60.0) == ("UTC", pytest.approx(0.08, abs=0.001))
    vehicle.clock.add_utc(1e9 + 60.0 - utc_behind_s, vehicle.boot_s(60.0), 1e9)
    assert vehicle.clock.quality(60.0) == ("one-way", pytest.approx(0.05))
    assert vehicle.clock.one_way_delay_s(60.0) is None


def test_utc_counts_for_less_the_longer_a_vehicle_is_up_nothing_beside_timesync_and_is_forgotten_with_the_clock():
    vehicle = Exchange(1, 20_000.0, 0.0, QUEUE, QUEUE)
    vehicle.run(0.0, 60.0)
    vehicle.clock.add_utc(1e9 + 60.0 - 0.5, vehicle.boot_s(60.0), 1e9)
    assert vehicle.clock.quality(60.0)[0] == "TIMESYNC"
    assert vehicle.clock.one_way_delay_s(60.0) == pytest.approx(0.05, abs=0.005)
    assert vehicle.clock.quality(400.0) == ("UTC", pytest.approx(0.41, abs=0.01))
    vehicle.clock.learn(1.0, 401.0)
    for at_s in (401.1, 401.2, 401.3):
        vehicle.clock.learn(at_s - 400.0, at_s)
    assert vehicle.clock.quality(401.3)[0] == "one-way"


def test_requests_are_quick_at_first_then_at_the_set_rate_and_rare_where_nobody_answers():
    answering, silent = Exchange(3, 0.0, 0.0, UNIFORM, UNIFORM), Exchange(3, 0.0, 0.0, UNIFORM, None)
    answering.run(0.0, 10.0)
    silent.run(0.0, 10.0)
    assert answering.asked == 50
    assert silent.asked == 20
    before = answering.asked
    answering.run(20.0, 60.0)
    silent.run(20.0, 60.0)
    assert answering.asked - before == pytest.approx(42, abs=4)
    assert silent.asked - 20 <= 4


def test_after_five_minutes_without_an_answer_the_bound_is_the_least_delay_again():
    vehicle = Exchange(4, 0.0, 0.0, UNIFORM, UNIFORM)
    vehicle.run(0.0, 60.0)
    vehicle.up = None
    vehicle.run(60.0, 370.0)
    assert vehicle.clock.synchronised(300.0) is not None
    assert vehicle.clock.to_service(vehicle.boot_s(370.0), 370.0).sigma_s == 0.25


def test_a_reboot_forgets_the_old_offset_and_finds_the_new_one():
    vehicle = Exchange(5, 900.0, 0.0, UNIFORM, UNIFORM)
    vehicle.run(0.0, 60.0)
    vehicle.offset_s = -60.0
    for i in range(3):
        vehicle.clock.learn(1.0 + i / 10, 61.3 + i / 10)
    assert vehicle.clock.resets == 1
    assert vehicle.clock.synchronised(61.5) is None
    vehicle.run(62.0, 120.0)
    assert abs(vehicle.error_s(120.0)) < 0.02  # 100 exchanges


@pytest.mark.parametrize("step_s", [-1.5, -1.0, 1.0, 1.5])
@pytest.mark.parametrize("delay", [UNIFORM, BELL, QUEUE], ids=["uniform", "bell", "queue"])
def test_a_step_of_a_second_is_noticed_within_half_a_second_and_the_new_offset_found(delay, step_s):
    for seed in range(4):
        vehicle = Exchange(seed, 700.0, 20e-6, delay, delay)
        vehicle.run(0.0, 60.0)
        assert vehicle.clock.resets == 0
        vehicle.offset_s += step_s
        vehicle.run(60.0, 61.0)
        # Forward: the first stamps that come before they were made, beyond the least delay and 4 sigma. Back: the first three
        # in a row further behind than 1.5 x 350 ms of jitter explains.
        began_at_s = vehicle.clock.stamps.began_at_s
        assert began_at_s > 60.0
        assert vehicle.stamps_refused <= 5
        vehicle.run(61.0, 90.0)
        assert vehicle.clock.stamps.began_at_s == began_at_s
        assert abs(vehicle.error_s(90.0)) < 0.05  # some 60 exchanges since


@pytest.mark.parametrize("step_s", [-0.4, 0.4])
def test_a_smaller_step_is_noticed_with_two_exchanges_or_three_stamps_that_no_delay_explains(step_s):
    quick: Delay = lambda rng: float(rng.uniform(0.02, 0.06))  # noqa: E731
    for seed in range(6):
        vehicle = Exchange(seed, 700.0, -20e-6, quick, quick)
        vehicle.run(0.0, 60.0)
        vehicle.offset_s += step_s
        vehicle.run(60.0, 62.0)  # asked once a second, and at once again where the answer cannot be
        began_at_s = vehicle.clock.stamps.began_at_s
        assert began_at_s > 60.0
        vehicle.run(62.0, 70.0)
        assert vehicle.clock.stamps.began_at_s == began_at_s
        assert abs(vehicle.error_s(70.0)) < 0.02


@pytest.mark.parametrize("drift", [-0.04, -0.01, 0.01, 0.04])
@pytest.mark.parametrize("delay", [UNIFORM, QUEUE], ids=["uniform", "queue"])
def test_a_clock_that_goes_wrong_by_per_cents_as_a_slow_simulations_does_is_not_taken_for_one_that_steps(delay, drift):
    for seed in range(4):
        vehicle = Exchange(seed, 30.0, drift, delay, delay)
        vehicle.run(0.0, 200.0)
        assert (vehicle.clock.resets, vehicle.stamps_refused) == (0, 0)


class UnevenClock(Exchange):
    """A simulation's clock: 2 % fast, 4 % slow, right, 1 % fast, five seconds each, and it stands still for 0.33 s at 90 s."""

    def boot_s(self, at_s: float) -> float:
        ahead_s = np.interp(at_s % 20.0, [0.0, 5.0, 10.0, 15.0, 20.0], [0.0, 0.1, -0.1, -0.1, -0.05])
        return at_s + self.offset_s - 0.05 * (at_s // 20.0) + ahead_s - min(max(at_s - 90.0, 0.0), 0.33)


def test_the_uneven_clock_of_a_simulation_is_followed():
    quick: Delay = lambda rng: float(rng.uniform(0.001, 0.004))  # noqa: E731
    clock = UnevenClock(5, 30.0, 0.0, quick, quick)
    errors_s = []
    for second in range(120):
        clock.run(float(second), second + 1.0)
        errors_s.append(abs(clock.error_s(second + 0.9)))
    assert clock.clock.resets == 0
    assert sorted(errors_s[20:])[95] < 0.02  # of 100 seconds


def test_a_single_answer_that_cannot_be_is_refused_and_begins_nothing_anew():
    vehicle = Exchange(8, 300.0, 0.0, QUEUE, QUEUE)
    vehicle.run(0.0, 60.0)
    ts1 = vehicle.clock.round_trips.request(7, 61.0, SETTINGS.timesync_period_s)
    assert ts1 is not None
    before = vehicle.clock.synchronised(61.0)
    assert vehicle.clock.add_answer(ts1, vehicle.boot_s(61.05) + 2.0, 61.1) == CoreRefusal.TIMESYNC_CONTRADICTORY
    vehicle.run(61.2, 70.0)
    assert vehicle.clock.resets == 0
    assert before is not None
    assert vehicle.error_s(70.0) == pytest.approx(0.0, abs=0.01)


def test_the_wrap_of_32_bits_goes_by_without_a_trace():
    wrap_s = 2**32 / 1e3
    clock = VehicleClock()
    for i in range(1, 400):
        at_s = i * 0.1
        boot_s = wrap_s - 20.0 + at_s
        ts1 = clock.round_trips.request(1, at_s, 1.0)
        if ts1 is not None and i > 1:
            # The answer's 64 bits do not wrap.
            assert clock.add_answer(ts1, boot_s + 0.1, at_s + 0.2) is None
        assert clock.learn(boot_s % wrap_s, at_s + 0.1)
        assert clock.to_service(boot_s % wrap_s, at_s + 0.2).at_s == pytest.approx(at_s, abs=1e-3 if i > 2 else 0.2)
    assert clock.resets == 0


def known() -> VehicleClock:
    clock = VehicleClock()
    for i in range(10):
        clock.learn(100.0 + i, 0.1 + i)
    return clock


def test_answers_that_nobody_asked_for_are_old_or_do_not_fit_are_refused():
    clock = known()
    ts1 = clock.round_trips.request(1, 10.0, 1.0)
    assert ts1 is not None
    assert clock.add_answer(ts1 + 1, 110.05, 10.1) == CoreRefusal.TIMESYNC_NOT_REQUESTED
    assert clock.add_answer(ts1, 1.7e9, 10.1) == CoreRefusal.TIMESYNC_OFF_BOOT_TIME
    assert clock.add_answer(ts1, 110.05, 10.1) == CoreRefusal.TIMESYNC_NOT_REQUESTED  # once only
    ts1 = clock.round_trips.request(1, 11.0, 1.0)
    assert ts1 is not None
    assert clock.add_answer(ts1, 111.05, 14.1) == CoreRefusal.TIMESYNC_TOO_OLD
    assert clock.synchronised(14.1) is None
    assert VehicleClock().add_answer(1, 5.0, 1.0) == CoreRefusal.TIMESYNC_BEFORE_BOOT_TIME


@pytest.mark.parametrize("period_s", [0.1, 0.2, 1.0])
def test_answers_count_on_a_link_of_2_s_however_often_they_are_asked_for(period_s):
    clock = VehicleClock()
    under_way: list[tuple[float, int]] = []
    refused: list[CoreRefusal | None] = []
    for poll in range(300):
        now_s = 10.0 + poll * 0.1
        clock.learn(now_s - 1.0 + 100.0, now_s)
        ts1 = clock.round_trips.request(7, now_s, period_s)
        if ts1 is not None:
            under_way.append((now_s, ts1))
        while under_way and under_way[0][0] + 2.0 <= now_s:
            asked_s, ts1 = under_way.pop(0)
            refused.append(clock.add_answer(ts1, asked_s + 1.0 + 100.0, now_s))
    known = clock.round_trips.estimate(40.0)
    assert set(refused) == {None}
    assert known is not None
    assert known.offset_s == pytest.approx(-100.0, abs=0.05)


def test_a_device_on_the_autopilots_clock_uses_its_offset_and_another_the_links_delay():
    vehicle = Exchange(6, 300.0, 0.0, QUEUE, QUEUE)
    vehicle.run(0.0, 200.0)
    same, other = SenderClock(), SenderClock()
    rng = np.random.default_rng(7)
    for at_s in np.arange(150.0, 200.0, 0.1):
        same.learn(vehicle.boot_s(at_s), at_s + QUEUE(rng))
        other.learn(at_s + 1.7e9, at_s + QUEUE(rng))
    first, second = (
        vehicle.clock.device_to_service(device, stamp_s, 200.0)
        for device, stamp_s in ((same, vehicle.boot_s(199.0)), (other, 199.0 + 1.7e9))
    )
    assert first.at_s == pytest.approx(199.0, abs=0.003)
    assert second.at_s == pytest.approx(199.0, abs=0.006)
    assert first.sigma_s < second.sigma_s < 0.01
    unanswered = VehicleClock().device_to_service(other, 199.0 + 1.7e9, 200.0)
    assert unanswered.at_s == pytest.approx(199.05, abs=0.003)
    assert unanswered.sigma_s == SETTINGS.min_delay_sigma_s


@pytest.mark.parametrize("up", [QUEUE, None], ids=["answered", "not answered"])
def test_a_device_whose_stamps_wait_longer_than_the_autopilots_may_be_late_by_more(up):
    """Each range waits 0.2 to 0.9 s in a companion computer, as beside a real ArduPlane: the least of them shows in nothing."""
    vehicle = Exchange(6, 300.0, 0.0, QUEUE, up)
    vehicle.run(0.0, 200.0)
    device, rng = SenderClock(), np.random.default_rng(7)
    for at_s in np.arange(150.0, 200.0, 0.1):
        device.learn(at_s + 1.7e9, at_s + rng.uniform(0.2, 0.9))
    told = vehicle.clock.device_to_service(device, 199.0 + 1.7e9, 200.0)
    assert 0.1 < told.at_s - 199.0 < told.sigma_s


@pytest.mark.parametrize("device_epoch_s", [1.7e9, None], ids=["a clock of its own", "the autopilot's"])
@pytest.mark.parametrize("up", [QUEUE, None], ids=["answered", "not answered"])
def test_a_device_whose_clock_is_set_back_by_less_than_a_jump_is_as_uncertain_as_that(up, device_epoch_s):
    vehicle = Exchange(6, 300.0, 0.0, QUEUE, up)
    vehicle.run(0.0, 140.0)
    device, rng = SenderClock(), np.random.default_rng(7)

    def stamp_s(at_s: float) -> float:
        set_back_s = 0.4 if at_s >= 130.0 else 0.0
        return (at_s + device_epoch_s if device_epoch_s is not None else vehicle.boot_s(at_s)) - set_back_s

    told = {}
    for at_s in np.arange(60.0, 140.0, 0.05):
        assert device.learn(stamp_s(at_s), at_s + QUEUE(rng))
        told[round(float(at_s), 2)] = vehicle.clock.device_to_service(device, stamp_s(at_s), at_s)
    assert told[129.0].sigma_s < (0.01 if up is not None else 0.26)
    for at_s in (132.0, 135.0, 139.0):
        assert abs(told[at_s].at_s - at_s) < 1.5 * told[at_s].sigma_s
