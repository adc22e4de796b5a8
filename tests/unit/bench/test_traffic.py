"""The traffic of the benchmarks is that of an aircraft, and what counts as unused is."""

from bench.traffic import OTHERS, fleet_traffic, message_id_of
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.inbound import CONVERTERS
from gcs_coloc.mavlink.refusals import Refusal


def test_what_the_service_is_said_to_pass_over_it_decodes_nothing_of():
    assert not CONVERTERS.keys() & set(OTHERS)


def test_nothing_of_the_rest_is_refused():
    decoder = Decoder()
    sent = fleet_traffic(2.0)
    assert {message_id_of(each.payload) for each in sent} > set(OTHERS)
    for each in sent:
        decoder.decode(each.payload, each.at_s)
    assert set(decoder.counts) == {Refusal.NOT_WANTED}
