"""What is told of the time of signatures: once each time that it comes to be ahead of the host's clock."""

from __future__ import annotations

import pytest
from signed_frames import KEY, UNIX_S, Signer

from gcs_coloc.config.sections import SigningConfig
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.decoder import Decoder

LINK = "udpin:127.0.0.1:14550"
NOW_S = 50.0


@pytest.fixture
def signed(tmp_path):
    key_file = tmp_path / "signing.key"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o600)
    links = SignedLinks(SigningConfig(key_file=str(key_file), mode="require"), [LINK])
    links.set_clock(UNIX_S - NOW_S)
    return links


@pytest.mark.parametrize(
    ("ahead_s", "words"), [(90, "2 minutes"), (10_800, "3 hours"), (86_400, "24 hours"), (604_800, "7 days")]
)
def test_a_time_of_signatures_that_a_vehicle_brought_ahead_is_told_once(signed, ahead_s, words):
    assert signed.pending_warning(NOW_S) is None
    vehicle = Signer()
    vehicle.mav.signing.timestamp += ahead_s * 100_000
    assert Decoder().decode(vehicle.pack(), NOW_S, "address", signed.of(LINK))
    assert f"{words} ahead of this computer's clock" in signed.pending_warning(NOW_S)
    assert signed.pending_warning(NOW_S + 1.0) is None


def test_so_is_one_that_the_hosts_own_clock_left_behind_when_it_was_set_back_and_again_after_it_was_right(signed):
    signed.of(LINK).stamp(NOW_S)
    assert signed.pending_warning(NOW_S) is None
    for _ in range(2):
        signed.set_clock(UNIX_S - NOW_S - 7200.0)
        assert "2 hours ahead" in signed.pending_warning(NOW_S)
        signed.set_clock(UNIX_S - NOW_S)
        assert signed.pending_warning(NOW_S) is None


def test_links_without_a_key_have_no_time_of_signatures():
    assert SignedLinks(SigningConfig(), [LINK]).pending_warning(NOW_S) is None
