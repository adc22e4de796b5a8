from __future__ import annotations

import itertools

import pytest

from gcs_coloc.estimators.fleet.out_of_sequence import Entry, OosmBuffer


class Tape:
    """Writes down what it is given; a model whose state depends on every order there is."""

    def __init__(self, words: tuple[str, ...] = ()) -> None:
        self.words = words

    def copy(self) -> Tape:
        return Tape(self.words)


def write(tape: Tape, entry: Entry[str]) -> str:
    tape.words = (*tape.words, entry.event)
    return "written"


@pytest.mark.parametrize("order", list(itertools.permutations(range(5)))[::7])
def test_any_order_of_arrival_gives_the_order_of_time(order):
    buffer: OosmBuffer[Tape, str] = OosmBuffer(Tape(), write, 10.0)
    for i in order:
        assert buffer.insert((i * 0.15,), str(i))
        buffer.process()
    assert buffer.model.words == ("0", "1", "2", "3", "4")


def test_the_same_key_is_taken_once():
    buffer: OosmBuffer[Tape, str] = OosmBuffer(Tape(), write, 10.0)
    assert buffer.insert((1.0, 2.0), "x")
    assert not buffer.insert((1.0, 2.0), "x")


def test_what_is_older_than_the_window_is_settled_and_forgotten():
    buffer: OosmBuffer[Tape, str] = OosmBuffer(Tape(), write, 1.0)
    for k in range(1000):
        buffer.insert((k * 0.05,), str(k))
        buffer.commit(k * 0.05)
    buffer.process()
    assert len(buffer._entries) < 30
    assert len(buffer._copies) < 16
    assert buffer.outcomes == {"written": 1000}
    assert buffer.model.words == tuple(map(str, range(1000)))


def test_a_late_event_within_the_window_is_put_in_its_place_after_settling():
    buffer: OosmBuffer[Tape, str] = OosmBuffer(Tape(), write, 1.0)
    for k in range(100):
        buffer.insert((k * 0.1,), str(k))
        buffer.commit(k * 0.1)
        buffer.process()
    buffer.insert((9.05,), "late")
    assert buffer.process().words[-10:] == ("90", "late", "91", "92", "93", "94", "95", "96", "97", "98", "99")[-10:]


def test_to_forget_applies_nothing_that_may_still_be_preceded_by_something_late():
    buffer: OosmBuffer[Tape, str] = OosmBuffer(Tape(), write, 1.0)
    for k in range(20):
        buffer.insert((k * 0.1,), str(k))
    buffer.process()
    before = buffer.model.words
    for k in range(20, 25):
        buffer.insert((k * 0.1,), str(k))
        buffer.commit(k * 0.1)
    assert buffer.model.words == before
    assert len(buffer._entries) < 25, "something was forgotten"
    buffer.insert((2.05,), "late")
    assert buffer.process().words == (*map(str, range(21)), "late", "21", "22", "23", "24")


class CountedTape(Tape):
    """Counts how often it and what came of it was copied, and what was written."""

    copies = written = 0

    def copy(self) -> CountedTape:
        CountedTape.copies += 1
        return CountedTape(self.words)


def write_and_count(tape: Tape, entry: Entry[str]) -> str:
    CountedTape.written += 1
    return write(tape, entry)


def test_the_newest_event_waits_for_no_copy_that_the_next_one_can_make():
    buffer: OosmBuffer[CountedTape, str] = OosmBuffer(CountedTape(), write_and_count, 10.0)
    buffer.insert((0.0,), "0")
    buffer.process()
    CountedTape.copies = 0
    buffer.insert((0.06,), "1")
    buffer.process()
    assert CountedTape.copies == 0
    buffer.insert((0.07,), "2")
    buffer.insert((0.08,), "3")
    buffer.process()
    assert CountedTape.copies == 1
    # What is late between the last two takes the model back no further than to that copy.
    buffer.insert((0.075,), "late")
    CountedTape.written = 0
    assert buffer.process().words == ("0", "1", "2", "late", "3")
    assert CountedTape.written == 3


def test_single_events_do_not_put_off_the_copies_for_ever():
    buffer: OosmBuffer[CountedTape, str] = OosmBuffer(CountedTape(), write_and_count, 10.0)
    CountedTape.copies = 0
    for k in range(100):
        buffer.insert((k * 0.02,), str(k))
        buffer.process()
    # One before the first event that is 0.1 s after the last copy, of events 0.02 s apart.
    assert CountedTape.copies >= 2.0 // 0.12


def test_copies_are_as_close_as_that_only_near_the_newest_event():
    buffer: OosmBuffer[CountedTape, str] = OosmBuffer(CountedTape(), write_and_count, 10.0)
    CountedTape.copies = 0
    for k in range(0, 200, 2):
        for one in (k, k + 1):
            buffer.insert((one * 0.03,), str(one))
        buffer.process()
    assert CountedTape.copies > 95
    assert len(buffer._copies) < 60
    for late in (5.2, 3.2, 1.2):
        CountedTape.written = 0
        buffer.insert((late + 0.01,), "late")
        buffer.process()
        # Itself and what is newer, and of what is older no more than 0.15 s hold.
        assert CountedTape.written <= 1 + (6.0 - late + 0.15) / 0.03 + 3
