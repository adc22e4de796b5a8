"""The place in a recording moves with the clock that is passed in, and never leaps to make up for a machine that is too slow."""

from __future__ import annotations

from math import inf

from gcs_coloc.recorder.playhead import Playhead


def moved(head: Playhead, now_s: float) -> float:
    due_s = head.due_s(now_s)
    head.reached(due_s, due_s)
    return head.at_s


def test_it_plays_at_its_speed_from_where_the_speed_was_set():
    head = Playhead(100.0, 200.0, 2.0)
    assert [moved(head, now_s) for now_s in (5.0, 6.0, 7.5)] == [100.0, 102.0, 105.0]
    head.set_speed(0.5)
    assert [moved(head, now_s) for now_s in (8.0, 10.0)] == [105.0, 106.0]
    head.set_speed(inf)
    assert head.due_s(10.0) == 200.0


def test_a_pause_is_no_time():
    head = Playhead(0.0, 100.0, 1.0)
    assert [moved(head, now_s) for now_s in (0.0, 3.0)] == [0.0, 3.0]
    head.pause()
    assert moved(head, 50.0) == 3.0
    head.play()
    assert [moved(head, now_s) for now_s in (60.0, 61.0)] == [3.0, 4.0]


def test_it_goes_to_a_place_within_the_recording_and_on_from_there():
    head = Playhead(10.0, 100.0, 1.0)
    for wish_s, place_s in ((50.0, 50.0), (500.0, 100.0), (-5.0, 10.0)):
        head.seek(wish_s)
        assert head.goal_s == place_s
        assert moved(head, 1.0) == place_s
        assert head.goal_s is None
    head.play()
    assert [moved(head, now_s) for now_s in (2.0, 3.0)] == [10.0, 11.0]


def test_it_stops_at_the_end_and_plays_from_the_beginning_again():
    head = Playhead(0.0, 10.0, 1.0)
    assert [moved(head, now_s) for now_s in (0.0, 30.0)] == [0.0, 10.0]
    assert not head.playing
    head.play()
    assert head.goal_s == 0.0
    assert [moved(head, now_s) for now_s in (31.0, 31.0, 32.0)] == [0.0, 0.0, 1.0]


def test_what_a_slow_machine_does_not_manage_is_not_caught_up_with():
    head = Playhead(0.0, 1000.0, 100.0)
    head.reached(0.0, head.due_s(0.0))
    head.reached(20.0, head.due_s(1.0))
    assert head.due_s(1.0) == 20.0
    assert head.due_s(1.5) == 70.0
