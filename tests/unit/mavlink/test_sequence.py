import pytest

from gcs_coloc.mavlink.decoder import MAX_SENDERS, REMEMBERED_FRAMES, SequenceTracker

VEHICLE = ("address", 1, 1)


def heard(tracker, sequences, at_s=0.0):
    return [tracker.add(VEHICLE, number & 0xFF, checksum=number * 7919 & 0xFFFF, received_at_s=at_s) for number in sequences]


def tally(tracker):
    (link,) = tracker.links([1])
    return link.received, link.lost, link.duplicates


def test_unbroken_numbers_lose_nothing_over_the_wrap():
    tracker = SequenceTracker()
    assert all(heard(tracker, range(250, 800)))
    assert tally(tracker) == (550, 0, 0)


def test_gap_counts_the_lost():
    tracker = SequenceTracker()
    heard(tracker, [253, 254, 260])
    assert tally(tracker) == (3, 5, 0)


def test_late_frame_is_not_lost():
    tracker = SequenceTracker()
    assert all(heard(tracker, [1, 2, 4, 3, 5]))
    assert tally(tracker) == (5, 0, 0)


def test_several_late_frames_in_a_row_are_not_lost():
    tracker = SequenceTracker()
    heard(tracker, [2, 1, 6, 3, 4, 5, 7])
    assert tally(tracker) == (7, 0, 0)


@pytest.mark.parametrize("anew", [range(30), range(240, 270)])
def test_losses_are_not_forgotten_where_a_sender_counts_anew_or_was_silent_for_long(anew):
    tracker = SequenceTracker()
    heard(tracker, [*range(90), *range(92, 101)])
    heard(tracker, anew, at_s=10.0)
    assert tally(tracker) == (99 + 30, 2, 0)
    heard(tracker, [anew[-1] + 4], at_s=10.0)
    assert tally(tracker) == (99 + 31, 5, 0)


def test_a_copy_that_comes_late_moves_nothing():
    """A router may deliver a frame again after whatever time."""
    tracker = SequenceTracker()
    heard(tracker, range(10))
    heard(tracker, [3, 10, 4, 11], at_s=10.0)
    assert tally(tracker) == (14, 0, 0)


def test_copy_is_refused_even_when_late():
    tracker = SequenceTracker()
    assert heard(tracker, [1, 2, 3, 4, 2, 4]) == [True, True, True, True, False, False]
    assert tally(tracker) == (4, 0, 2)


def test_same_number_with_another_checksum_is_no_copy():
    tracker = SequenceTracker()
    assert tracker.add(VEHICLE, 9, checksum=1, received_at_s=0.0)
    assert tracker.add(VEHICLE, 9, checksum=2, received_at_s=0.0)


def test_sender_that_never_counts_on_is_heard():
    """Its heartbeat has the same bytes each time; only a copy that comes at once is taken for a copy."""
    tracker = SequenceTracker()
    for second in range(10):
        assert tracker.add(VEHICLE, 0, checksum=1, received_at_s=float(second))
        assert not tracker.add(VEHICLE, 0, checksum=1, received_at_s=second + 0.2)
    assert tally(tracker) == (10, 0, 10)


def test_memory_of_one_sender_is_bounded():
    tracker = SequenceTracker()
    frames = [(number & 0xFF, number, 0.0) for number in range(REMEMBERED_FRAMES + 1)]
    assert all(tracker.add(VEHICLE, *frame) for frame in frames)
    assert not tracker.add(VEHICLE, *frames[1])
    assert tracker.add(VEHICLE, *frames[0])


def test_senders_are_apart_by_address_and_component():
    tracker = SequenceTracker()
    for sender in [VEHICLE, ("elsewhere", 1, 1), ("address", 1, 191), ("address", 2, 1)]:
        assert tracker.add(sender, 7, checksum=1, received_at_s=0.0)
    assert [link.received for link in tracker.links([1, 2])] == [3, 1]


def test_flood_of_senders_is_bounded_and_a_lively_one_stays():
    tracker = SequenceTracker()
    for number in range(3 * MAX_SENDERS):
        tracker.add(("made up", number + 2, 1), 0, checksum=0, received_at_s=0.0)
        tracker.add(VEHICLE, number & 0xFF, checksum=number & 0xFFFF, received_at_s=0.0)
    made_up = tracker.links(range(2, 3 * MAX_SENDERS + 2))
    assert sum(link.received for link in made_up) == MAX_SENDERS - 1
    assert tally(tracker) == (3 * MAX_SENDERS, 0, 0)
