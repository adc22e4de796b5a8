"""When the same attitude again is one that nobody has measured, and when it is what a sound sender tells."""

import numpy as np
import pytest
from built_measurements import Builder, vehicle

from gcs_coloc.core.messages.inbound import Airspeed, Attitude
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.telemetry.reported_state import RepeatedAttitudes

EVERY_S = 0.1


def attitudes(count, each=1, from_s=0.0, seed=1):
    """Noisy attitudes, each of them told several times, one every tenth of a second."""
    angles = np.repeat(0.02 * np.random.default_rng(seed).standard_normal((count, 3)), each, axis=0).tolist()
    return [at(from_s + EVERY_S * k, angles_rad) for k, angles_rad in enumerate(angles)]


def at(at_s, angles_rad):
    return Attitude(4, at_s, at_s, *angles_rad)


def test_a_sender_that_never_repeated_an_attitude_is_found_at_the_first_repeat_and_believed_at_the_first_change():
    repeats, told = RepeatedAttitudes(), attitudes(50)
    assert not any(repeats.add(attitude) for attitude in told)
    last = told[-1].roll_rad, told[-1].pitch_rad, told[-1].yaw_rad
    assert all(repeats.add(at(5.0 + EVERY_S * k, last)) for k in range(300))
    assert not any(repeats.add(attitude) for attitude in attitudes(50, from_s=40.0, seed=2))
    # However long it repeated, the next time is found as well.
    last = repeats._last.roll_rad, repeats._last.pitch_rad, repeats._last.yaw_rad
    assert repeats.add(at(50.0, last))


@pytest.mark.parametrize("each", [2, 5])
def test_a_bridge_that_tells_each_attitude_several_times_is_not_judged(each):
    repeats = RepeatedAttitudes()
    assert not any(repeats.add(attitude) for attitude in attitudes(200, each))


def test_the_same_message_by_a_second_link_is_no_repeat():
    repeats = RepeatedAttitudes()
    assert not any(repeats.add(attitude) for attitude in attitudes(100) for _ in range(2))


def test_what_only_repeats_is_counted_shows_no_motion_and_is_as_old_as_its_first():
    feed, record = Builder(), vehicle()
    record.winged, record.airspeed = True, Airspeed(4, 4.5, 22.0)
    for attitude in attitudes(50):
        assert feed.measure_attitude(attitude, record) is not None
    shown_until_s = feed.attitude_at_s(4)
    again = at(5.0, (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad))
    assert feed.measure_attitude(again, record) is None
    assert feed.refused == {CoreRefusal.ATTITUDE_REPEATED: 1}
    assert feed.attitude_at_s(4) == shown_until_s
    assert record.attitude is attitude
