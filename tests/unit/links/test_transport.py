"""What a slow stream has not taken is bounded, and it is the newest that is kept."""

from gcs_coloc.links.transport import MAX_FORWARDED_BYTES, Outbox
from gcs_coloc.mavlink.refusals import Counts, Refusal


def drained(outbox):
    return list(iter(outbox.pop, None))


def test_the_oldest_make_room_for_the_newest_and_are_counted():
    counts = Counts()
    outbox = Outbox(counts, most_bytes=10)
    for payload in (b"aaaa", b"bbbb", b"cccc", b"dd"):
        outbox.put(payload)
    assert drained(outbox) == [b"bbbb", b"cccc", b"dd"]
    assert counts[Refusal.OUTPUT_SKIPPED] == 1


def test_what_was_taken_makes_room_again():
    counts = Counts()
    outbox = Outbox(counts, most_bytes=4)
    for payload in (b"aaaa", b"bbbb"):
        outbox.put(payload)
        assert outbox.pop() == payload
    assert not counts


def test_a_payload_larger_than_the_bound_is_dropped_and_nothing_else_is_harmed():
    counts = Counts()
    outbox = Outbox(counts, most_bytes=4)
    outbox.put(b"aaaaa")
    outbox.put(b"bb")
    assert drained(outbox) == [b"bb"]
    assert counts[Refusal.OUTPUT_SKIPPED] == 1


def test_what_waited_for_a_lost_connection_is_forgotten():
    outbox = Outbox(Counts(), most_bytes=4)
    outbox.put(b"aaaa")
    outbox.clear()
    outbox.put(b"bbbb")
    assert drained(outbox) == [b"bbbb"]


def test_what_is_forwarded_waits_for_the_rest_and_pushes_nothing_of_it_out():
    counts = Counts()
    outbox = Outbox(counts, most_bytes=8)
    outbox.put(b"fix1")
    for _ in range(MAX_FORWARDED_BYTES // 4 + 1):
        outbox.put(b"ftp!", forwarded=True)
    outbox.put(b"fix2")
    assert outbox.size == 8 + MAX_FORWARDED_BYTES
    assert counts[Refusal.OUTPUT_SKIPPED] == 1
    assert drained(outbox)[:3] == [b"fix1", b"fix2", b"ftp!"]
    assert outbox.size == 0
