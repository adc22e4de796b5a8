"""Refusals are counted by members of closed enums, warned of once with the remedy; routine ones are not shown."""

from gcs_coloc.mavlink.refusals import Counts, Field, InvalidValue, Refusal, Refusals


def test_counts_add_up_by_reason():
    counts, more = Counts(), Counts()
    counts.add(Refusal.BAD_CRC)
    counts.add(Refusal.BAD_CRC, 2)
    more.add(Refusal.BAD_CRC)
    more.add(InvalidValue("ATTITUDE", Field.ROLL))
    counts.update(more)
    assert dict(counts) == {"bad_crc": 4, "invalid_value:ATTITUDE.roll": 1}
    assert counts["truncated"] == 0
    assert "truncated" not in counts


def test_only_what_is_new_is_warned_of():
    wire, routes = Counts(), Counts()
    refusals = Refusals([wire, routes])
    assert refusals.pending_warning() is None
    wire.add(Refusal.BAD_CRC, 3)
    wire.add(Refusal.NOT_WANTED, 100)
    routes.add(Refusal.ADDRESS_CONFLICT)
    text = refusals.pending_warning()
    assert text is not None
    assert text.startswith("refused on the links: bad_crc 3, address_conflict 1 (two senders use one system id")
    assert "not_wanted" not in text
    assert refusals.pending_warning() is None
    wire.add(Refusal.BAD_CRC, 2)
    assert refusals.pending_warning() == "refused on the links: bad_crc 2"
    assert refusals.totals() == {"bad_crc": 5, "address_conflict": 1}


def test_answers_to_another_ground_station_are_counted_and_nothing_to_warn_of():
    wire = Counts()
    refusals = Refusals([wire])
    wire.add(Refusal.ANSWER_TO_ANOTHER, 7)
    assert refusals.pending_warning() is None
    assert refusals.totals() == {"answer_to_another": 7}
