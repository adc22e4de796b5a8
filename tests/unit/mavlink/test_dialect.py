"""The committed Python is what the XML generates; RANGING_BEACON and GNSS_INTEGRITY are MAVLink's own."""

import ast
from pathlib import Path
from xml.etree import ElementTree

import pymavlink.dialects.v20
import pytest
from pymavlink.dialects.v20 import ardupilotmega, development

from gcs_coloc.mavlink import framing
from gcs_coloc.mavlink._generated import gcs_coloc
from tools import regenerate_dialect


def message_code(path):
    """The message classes and the message map of a generated module, without its library part, which varies with pymavlink."""
    tree = ast.parse(path.read_text())
    wanted = {}
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name.endswith("_message") and node.name != "MAVLink_message":
            wanted[node.name] = ast.dump(node)
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "mavlink_map":
            wanted["mavlink_map"] = ast.dump(node)
    return wanted


def test_committed_module_is_what_the_xml_generates(tmp_path):
    fresh = tmp_path / "gcs_coloc.py"
    regenerate_dialect.generate(fresh)
    generated = message_code(fresh)
    assert set(generated) >= {"MAVLink_peer_range_message", "MAVLink_ranging_beacon_message", "mavlink_map"}
    assert message_code(regenerate_dialect.GENERATED_MODULE) == generated


def test_an_xml_that_breaks_the_schema_is_refused(tmp_path, monkeypatch):
    broken = tmp_path / "gcs_coloc.xml"
    xml = regenerate_dialect.DIALECT_XML.read_text()
    broken.write_text(xml.replace('type="float" name="range"', 'type="length" name="range"'))
    monkeypatch.setattr(regenerate_dialect, "DIALECT_XML", broken)
    with pytest.raises((RuntimeError, SystemExit)):
        regenerate_dialect.generate(tmp_path / "out.py")


def test_peer_range_has_its_fields_in_the_documented_order():
    message = gcs_coloc.MAVLink_peer_range_message
    assert message.id == 181600
    first = ["time_usec", "range", "range_std", "sequence", "peer_system", "quality", "device_id"]
    assert message.fieldnames == [*first, "peer_type", "peer_station", "peer_system_id"]
    assert message.ordered_fieldnames == message.fieldnames
    assert message.unpacker.format == "<QffHBBB" + "BHI"
    assert message.crc_extra == 116  # of the fields before the extensions: that of version 0.1


@pytest.mark.parametrize(("name", "crc_extra"), [("ranging_beacon", 99), ("gnss_integrity", 169)])
def test_a_message_of_mavlinks_development_is_its_own(name, crc_extra):
    ours, theirs = (getattr(dialect, f"MAVLink_{name}_message") for dialect in (gcs_coloc, development))
    assert ours.crc_extra == theirs.crc_extra == crc_extra
    assert ours.unpacker.format == theirs.unpacker.format
    assert ours.ordered_fieldnames == theirs.ordered_fieldnames


@pytest.mark.parametrize(
    ("message", "enums"),
    [
        ("RANGING_BEACON", ["RANGING_BEACON_ALT_TYPE", "RANGING_BEACON_STATUS_FLAG"]),
        (
            "GNSS_INTEGRITY",
            [
                "GPS_SYSTEM_ERROR_FLAGS",
                "GPS_AUTHENTICATION_STATE",
                "GPS_JAMMING_STATE",
                "GPS_SPOOFING_STATE",
                "GPS_RAIM_STATE",
            ],
        ),
    ],
)
def test_the_xml_is_a_verbatim_copy(message, enums):
    def definition(path):
        root = ElementTree.parse(path).getroot()
        parts = [root.find(f".//message[@name='{message}']"), *(root.find(f".//enum[@name='{name}']") for name in enums)]
        return [ElementTree.canonicalize(ElementTree.tostring(part), strip_text=True) for part in parts]

    theirs = Path(pymavlink.dialects.v20.__file__).parent / "development.xml"
    assert definition(regenerate_dialect.DIALECT_XML) == definition(theirs)


def test_pymavlinks_own_map_is_left_alone():
    assert 181600 in framing.MESSAGE_CLASSES
    assert 181600 not in ardupilotmega.mavlink_map
    assert framing.CRC_EXTRA[232] == ardupilotmega.MAVLink_gps_input_message.crc_extra
