"""What was refused is told once, with the mend, and the noise of a healthy day not at all."""

from gcs_coloc.links.refusals import Refusals
from gcs_coloc.mavlink.counts import Counts


def test_only_what_is_new_is_told():
    wire, routes = Counts(), Counts()
    refusals = Refusals([wire, routes])
    assert refusals.pending_warning() is None
    wire.add("bad_crc", 3)
    wire.add("not_wanted", 100)
    routes.add("address_conflict")
    text = refusals.pending_warning()
    assert text is not None
    assert text.startswith("refused on the links: bad_crc 3, address_conflict 1 (two senders use one system id")
    assert "not_wanted" not in text
    assert refusals.pending_warning() is None
    wire.add("bad_crc", 2)
    assert refusals.pending_warning() == "refused on the links: bad_crc 2"
    assert refusals.totals() == {"bad_crc": 5, "address_conflict": 1}


def test_answers_to_another_ground_station_are_counted_and_nothing_to_warn_of():
    wire = Counts()
    refusals = Refusals([wire])
    wire.add("answer_to_another", 7)
    assert refusals.pending_warning() is None
    assert refusals.totals() == {"answer_to_another": 7}
