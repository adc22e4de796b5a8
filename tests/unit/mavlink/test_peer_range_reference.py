"""What the reference tells those who send ranges is true: its examples run and are understood."""

import io
import re
import types
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.mavlink._generated import gcs_coloc as ours
from gcs_coloc.mavlink.decoder import Decoder

REFERENCE = (Path(__file__).resolve().parents[3] / "docs/reference/peer-range.md").read_text(encoding="utf-8")
C_TYPES = {"uint64_t": "Q", "float": "f", "uint32_t": "I", "uint16_t": "H", "uint8_t": "B"}


def examples(language):
    return re.findall(rf"```{language}\n(.*?)```", REFERENCE, flags=re.DOTALL)


def section_of(message_name):
    return REFERENCE.split(f"\n## {message_name}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize("message_name", ["PEER_RANGE", "RANGING_BEACON", "DEBUG_VECT", "NAMED_VALUE_FLOAT"])
def test_python_example_sends_a_range_that_is_understood(message_name, monkeypatch):
    sent = io.BytesIO()

    def connection(_address, source_system, source_component):
        return types.SimpleNamespace(mav=mavlink.MAVLink(sent, srcSystem=source_system, srcComponent=source_component))

    monkeypatch.setattr(mavutil, "mavlink_connection", connection)
    (example,) = re.findall(r"```python\n(.*?)```", section_of(message_name), flags=re.DOTALL)
    exec(compile(example, "peer-range.md", "exec"), {})
    decoder = Decoder()
    (frame,) = decoder.decode(sent.getvalue(), 0.0)
    assert dict(decoder.counts) == {}
    assert isinstance(frame.message, PeerRange)
    peer = station_node(3) if message_name == "RANGING_BEACON" else 3
    assert (frame.message.sysid, frame.message.peer, frame.message.range_m) == (4, peer, 812.5)
    assert frame.message.sigma_m == (None if message_name == "NAMED_VALUE_FLOAT" else 0.25)
    assert frame.message.line_of_sight is None
    assert frame.message.measured_at_s > 0.0


def test_c_struct_is_the_wire_layout():
    struct = next(example for example in examples("c") if "struct" in example)
    fields = re.findall(r"^\s+(\w+)\s+(\w+);", struct, flags=re.MULTILINE)
    message = ours.MAVLink_peer_range_message
    assert [name for _, name in fields] == message.ordered_fieldnames
    assert "<" + "".join(C_TYPES[kind] for kind, _ in fields) == message.unpacker.format


def test_numbers_of_the_reference_are_the_dialects():
    for message in (ours.MAVLink_peer_range_message, ours.MAVLink_ranging_beacon_message):
        section = section_of(message.msgname)
        assert f"id {message.id}, CRC extra {message.crc_extra}" in section
    assert f"{ours.MAVLink_peer_range_message.unpacker.size} bytes" in section_of("PEER_RANGE")


def test_field_table_names_every_field_with_its_type():
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", section_of("PEER_RANGE"), flags=re.MULTILINE)
    message = ours.MAVLink_peer_range_message
    assert rows == list(zip(message.fieldnames, message.fieldtypes, strict=True))


def test_lua_example_packs_debug_vect_as_the_wire_wants_it():
    (example,) = re.findall(r"```lua\n(.*?)```", section_of("DEBUG_VECT"), flags=re.DOTALL)
    message_id, packing = re.search(r'send_chan\(\d, (\d+), string\.pack\("(\S+?)"', example).groups()
    message = mavlink.mavlink_map[int(message_id)]
    assert message.msgname == "DEBUG_VECT"
    # Lua on ArduPilot has 32-bit integers: the 64-bit time is written as two halves.
    assert packing.replace("I4I4", "Q").replace("c10", "10s") == message.unpacker.format
