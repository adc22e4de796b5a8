import re

import pytest

from gcs_coloc.core.errors import UsageError
from gcs_coloc.links.base import SCHEMES, parse, parse_links, parse_out
from gcs_coloc.links.serial import SerialDevice
from gcs_coloc.links.tcp import TcpClient, TcpServer
from gcs_coloc.links.udp import UdpIn, UdpOut


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("14550", UdpIn("0.0.0.0", 14550)),
        (" 14550 ", UdpIn("0.0.0.0", 14550)),
        ("127.0.0.1:14550", UdpIn("127.0.0.1", 14550)),
        ("gcs.local:14550", UdpIn("gcs.local", 14550)),
        ("udp:14551", UdpIn("0.0.0.0", 14551)),
        ("udp:0.0.0.0:14551", UdpIn("0.0.0.0", 14551)),
        ("udpin:10.0.0.1:1", UdpIn("10.0.0.1", 1)),
        ("udpin:[::]:14550", UdpIn("::", 14550)),
        ("[fe80::1%eth0]:14550", UdpIn("fe80::1%eth0", 14550)),
        ("udpout:192.168.1.7:65535", UdpOut("192.168.1.7", 65535)),
        ("tcp:localhost:5760", TcpClient("localhost", 5760)),
        ("tcp:[::1]:5760", TcpClient("::1", 5760)),
        ("tcpin:5760", TcpServer("0.0.0.0", 5760)),
        ("tcpin:127.0.0.1:5760", TcpServer("127.0.0.1", 5760)),
        ("serial:/dev/ttyUSB0", SerialDevice("/dev/ttyUSB0", 57600)),
        ("serial:/dev/ttyUSB0:115200", SerialDevice("/dev/ttyUSB0", 115200)),
        ("/dev/ttyACM0", SerialDevice("/dev/ttyACM0", 57600)),
        ("/dev/ttyACM0,921600", SerialDevice("/dev/ttyACM0", 921600)),
        ("/dev/serial/by-id/usb-3D_Robotics-if00-port0", SerialDevice("/dev/serial/by-id/usb-3D_Robotics-if00-port0", 57600)),
        (
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0:57600",
            SerialDevice("/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0", 57600),
        ),
    ],
)
def test_customary_forms_are_understood(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize("text", ["14550", "udpout:[::1]:14550", "tcp:localhost:5760", "tcpin:5760", "/dev/ttyACM0,9600"])
def test_name_of_an_address_parses_to_the_same_address(text):
    assert parse(str(parse(text))) == parse(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "   ",
        "udp",
        "udpin:",
        "localhost",
        "localhost:",
        "localhost:port",
        "a b:14550",
        "udpout:14550",
        "tcp:5760",
        "a..b:14550",
        f"{'x' * 70}:14550",
        "udpin:::14550",
        "udpin:[::]",
        "udpin:1.2.3.4:14550:7",
        "foo:1.2.3.4:14550",
        "0",
        "65536",
        "-1",
        "99999999999999999999",
        "tcp:localhost:0",
        "１４５５０",
        "serial:",
        "serial:ttyUSB0",
        "serial:/dev/ttyUSB0:0",
        "serial:/dev/ttyUSB0,fast",
        "/dev/tty USB0",
    ],
)
def test_malformed_one_is_quoted_in_an_error_of_one_line(text):
    with pytest.raises(UsageError) as raised:
        parse(text)
    assert repr(text) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_error_shows_the_right_forms():
    with pytest.raises(UsageError, match=r"udpin:HOST:PORT.*serial:"):
        parse("nonsense")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("127.0.0.1:14551", UdpOut("127.0.0.1", 14551)),
        ("udp:127.0.0.1:14551", UdpOut("127.0.0.1", 14551)),
        ("udpout:[::1]:14551", UdpOut("::1", 14551)),
        ("udpin:14551", UdpIn("0.0.0.0", 14551)),
        ("tcp:10.0.0.2:5760", TcpClient("10.0.0.2", 5760)),
        ("tcpin:5760", TcpServer("0.0.0.0", 5760)),
        ("/dev/ttyUSB1:115200", SerialDevice("/dev/ttyUSB1", 115200)),
    ],
)
def test_a_ground_tool_is_sent_to_where_a_vehicle_would_be_listened_for(text, expected):
    assert parse_out(text) == expected


@pytest.mark.parametrize("text", ["14551", "udp:14551", "nonsense", "udp:host:99999", "serial:"])
def test_a_ground_tools_malformed_address_is_quoted_with_the_right_forms(text):
    with pytest.raises(UsageError, match=repr(text)) as caught:
        parse_out(text)
    assert "99999" in text or "udp:HOST:PORT" in str(caught.value)


@pytest.mark.parametrize(
    "links",
    [
        ["14550", "14550"],
        ["udpin:14550", "127.0.0.1:14550"],
        ["tcp:10.0.0.2:5760", "tcp:10.0.0.2:5760"],
        ["tcpin:0.0.0.0:5760", "tcpin:10.0.0.2:5760"],
        ["/dev/ttyUSB0", "serial:/dev/ttyUSB0:115200"],
    ],
)
def test_two_links_of_one_place_are_refused_by_name(links):
    with pytest.raises(UsageError, match="leave one out") as raised:
        parse_links(["tcp:10.0.0.9:1", *links])
    assert str(parse(links[1])) in str(raised.value)


def test_links_of_different_places_are_taken_in_their_order():
    links = [
        "udpin:127.0.0.1:14550",
        "udpin:127.0.0.2:14550",
        "tcpin:14550",
        "udpin:[::1]:14550",
        "udpout:127.0.0.1:14550",
        "/dev/ttyS0",
    ]
    assert parse_links(links) == [parse(text) for text in links]


def test_an_interface_of_any_name_may_stand_behind_a_link_local_address():
    assert parse("udpin:[fe80::1%br-lan.100]:14550") == UdpIn("fe80::1%br-lan.100", 14550)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("14550", "listening on udpin:0.0.0.0:14550"),
        ("tcpin:5760", "listening on tcpin:0.0.0.0:5760"),
        ("tcp:localhost:5760", "connecting to tcp:localhost:5760"),
        ("udpout:localhost:14550", "sending to udpout:localhost:14550"),
        ("/dev/ttyUSB0", "listening on serial:/dev/ttyUSB0:57600"),
    ],
)
def test_the_operator_is_told_what_a_link_does(text, words):
    assert parse(text).opening == words


@pytest.mark.parametrize("scheme", SCHEMES)
def test_each_scheme_of_the_registry_reads_its_own_form_back_and_makes_a_link_of_that_name(scheme):
    place = "/dev/ttyUSB7:9600" if scheme == "serial" else "127.0.0.1:5760"
    address = parse(f"{scheme}:{place}")
    assert str(address) == f"{scheme}:{place}"
    assert address.FORM.startswith(f"{scheme}:")
    with pytest.raises(UsageError, match=re.escape(address.FORM)):
        parse(f"{scheme}:")
    link = address.make_link(lambda *_: None, lambda: 0.0)
    assert link.name == str(address)
