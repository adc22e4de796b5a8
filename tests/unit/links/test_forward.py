"""What is refused of a ground tool's address before anything is opened, and the links' signing modes with ground tools."""

import pytest

from gcs_coloc.config import SigningConfig
from gcs_coloc.core.errors import UsageError
from gcs_coloc.links.forward import check_outs
from gcs_coloc.links.signed_links import SignedLinks


@pytest.mark.parametrize(
    ("out", "link"),
    [
        ("udp:127.0.0.1:14550", "14550"),
        ("localhost:14550", "127.0.0.1:14550"),
        ("udp:10.0.0.1:14550", "udpin:10.0.0.1:14550"),
        ("udpout:10.0.0.2:14550", "udpout:10.0.0.2:14550"),
        ("udpin:0.0.0.0:14550", "14550"),
        ("tcp:127.0.0.1:5760", "tcpin:5760"),
        ("tcp:10.0.0.9:5760", "tcp:10.0.0.9:5760"),
        ("/dev/ttyUSB0", "serial:/dev/ttyUSB0:115200"),
    ],
)
def test_a_ground_tool_that_would_be_one_of_the_vehicles_links_is_refused(out, link):
    with pytest.raises(UsageError, match="leads back to the vehicles' link"):
        check_outs([out], ["udpin:0.0.0.0:20000", link])


@pytest.mark.parametrize(
    ("out", "link"),
    [
        ("udp:127.0.0.1:14551", "14550"),
        ("udp:192.168.1.20:14550", "14550"),  # QGroundControl on another machine
        ("tcp:127.0.0.1:14550", "14550"),
        ("/dev/ttyUSB1", "/dev/ttyUSB0"),
        ("/dev/ttyUSB1", "14550"),
    ],
)
def test_a_ground_tool_elsewhere_is_taken(out, link):
    check_outs([out], [link])


def test_a_ground_tool_given_twice_is_refused():
    with pytest.raises(UsageError, match="given twice"):
        check_outs(["127.0.0.1:14551", "udpout:127.0.0.1:14551"], ["14550"])


def test_a_ground_tools_link_is_signed_like_the_others_unless_told(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text("ab" * 32)
    key_file.chmod(0o600)
    config = SigningConfig(key_file=str(key_file), mode="require", links={"udp:127.0.0.1:14552": "off"})
    signed = SignedLinks(config, ["14550"], ["udp:127.0.0.1:14551", "127.0.0.1:14552"])
    assert signed.of("udpout:127.0.0.1:14551").required
    assert signed.of("udpout:127.0.0.1:14552") is None
