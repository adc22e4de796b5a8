"""The doctor against simulated aircraft in processes of their own: a wrong set-up, and the same one corrected as it said."""

from __future__ import annotations

import json
import os
import random
import re
import socket
import subprocess
import sys
import tty
from pathlib import Path

import pytest
from command_line import gcs_coloc
from pymavlink import mavparm

from sitl_fakes.scenario import SCENARIOS

pytestmark = pytest.mark.integration

ROOT = Path(__file__).resolve().parents[2]
PAPER = (SCENARIOS / "paper.toml").read_text()
WRONG = {"GPS2_TYPE": 0, "GPS_PRIMARY": 1, "GPS_AUTO_SWITCH": 1, "MAV_OPTIONS": 1, "EK3_GPS_CHECK": 19}


def scenario(tmp_path, parameters) -> Path:
    """The paper's aircraft, the first of them a PX4, with these parameters on vehicle 4."""
    table = ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
    text, changed = re.subn(r"params = \{ EK3_GPS_CHECK = 19 \}", f"params = {{ {table} }}", PAPER)
    px4 = 'autopilot = "px4"\nparams = { EKF2_REQ_EPH = 30, EKF2_REQ_EPV = 60, EKF2_REQ_SACC = 5 }'
    text, changed_too = re.subn(r"params = \{ EK3_GPS_CHECK = 23 \}", px4, text, count=1)
    assert changed == changed_too == 1
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    return path


def examine(port, flown, *arguments) -> subprocess.CompletedProcess[str]:
    fakes = subprocess.Popen(
        [sys.executable, "-m", "sitl_fakes", str(flown), "--target", f"127.0.0.1:{port}"], stderr=subprocess.PIPE, text=True
    )
    try:
        assert fakes.stderr is not None
        assert "vehicles to" in fakes.stderr.readline()
        return gcs_coloc("doctor", "--udp", f"127.0.0.1:{port}", "--seconds", "10", *arguments)
    finally:
        fakes.kill()
        fakes.communicate()


def test_a_wrong_set_up_is_told_parameter_by_parameter_and_is_right_when_they_are_set(tmp_path, free_port, monkeypatch):
    told = examine(free_port, scenario(tmp_path, WRONG), "--aid", "4", "--json", "--write-params", str(tmp_path / "params"))
    assert told.returncode == 1, told.stderr
    report = json.loads(told.stdout)
    assert not report["ready"]
    assert [(v["sysid"], v["ready"]) for v in report["vehicles"]] == [(1, True), (2, True), (3, True), (4, False)]
    assert [v["autopilot"] for v in report["vehicles"]] == ["PX4", "ArduPilot", "ArduPilot", "ArduPilot"]
    parameters = report["vehicles"][0]["parameters"]
    assert {name: parameters[name] for name in ("EKF2_AGP0_CTRL", "EKF2_AGP0_DELAY", "EKF2_AGP0_ID")} == {
        "EKF2_AGP0_CTRL": 1.0,
        "EKF2_AGP0_DELAY": 0.0,
        "EKF2_AGP0_ID": 1.0,
    }
    findings = report["vehicles"][3]["findings"]
    assert any("MAV_GCS_SYSID = 255 only, and we are 254" in finding["text"] for finding in findings)
    settings = {name: value for finding in findings for name, value in (finding["set"] or {}).items()}
    asked = {"GPS2_TYPE": 14.0, "GPS_PRIMARY": 0.0, "GPS_AUTO_SWITCH": 4.0, "GPS2_DELAY_MS": 100.0, "EK3_SRC1_VELZ": 0.0}
    assert settings == asked
    file = mavparm.MAVParmDict()  # as MAVProxy loads it
    assert file.load(str(tmp_path / "params" / "vehicle-4.param"))
    assert dict(file) == asked
    assert sorted(path.name for path in (tmp_path / "params").iterdir()) == ["vehicle-4.param", "vehicle-4.params"]

    corrected = scenario(tmp_path, WRONG | settings)
    monkeypatch.setenv("GCS_COLOC_MAVLINK__SYSTEM_ID", "255")
    told = examine(free_port, corrected, "--aid", "4")
    assert told.returncode == 0, told.stdout + told.stderr
    lines = told.stdout.splitlines()
    assert lines[-1] == "result: all right; co-localisation can work"
    assert "  right  ranges to 3 others: 1, 2, 3" in lines
    assert not any(line.startswith("  STOP") for line in lines)


def test_positions_that_come_too_slowly_are_told_with_the_parameter_that_remedies_it(tmp_path, free_port, monkeypatch):
    """Where the service is not to ask for rates, those of the vehicle's port count."""
    coarse = {"EK3_GPS_CHECK": 19}
    monkeypatch.setenv("GCS_COLOC_FLEET__REQUEST_STREAMS", "false")
    slow = scenario(tmp_path, coarse | {"MAV1_POSITION": 1, "MAV1_EXT_STAT": 0})
    told = examine(free_port, slow, "--aid", "4", "--json")
    assert told.returncode == 1, told.stderr
    findings = json.loads(told.stdout)["vehicles"][3]["findings"]
    settings = {name: value for finding in findings for name, value in (finding["set"] or {}).items()}
    assert settings["MAV1_POSITION"] == 10.0
    assert settings["MAV1_EXT_STAT"] == 5.0
    assert any(r["severity"] == "stop" and r["text"] == "GPS_RAW_INT is not heard" for r in findings)
    assert any(r["text"].startswith("GLOBAL_POSITION_INT comes at ") for r in findings)

    told = examine(free_port, scenario(tmp_path, coarse | settings), "--aid", "4")
    assert told.returncode == 0, told.stdout + told.stderr
    assert "SERIAL" not in told.stdout


def test_where_nobody_sends_the_doctor_says_so(free_port):
    told = gcs_coloc("doctor", "--udp", f"127.0.0.1:{free_port}", "--seconds", "5")
    assert told.returncode == 1
    assert "no vehicle was heard in 5 s" in told.stdout
    assert "Traceback" not in told.stderr


def test_a_serial_device_that_brings_no_mavlink_is_asked_for_its_baud_rate():
    """What a radio at another speed looks like: bytes that mean nothing."""
    far_end, near_end = os.openpty()
    tty.setraw(near_end)
    garbage = random.Random(1)
    command = [sys.executable, "-m", "gcs_coloc", "doctor", "--link", os.ttyname(near_end), "--seconds", "5"]
    told = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert told.stderr is not None
    assert "listening on" in told.stderr.readline()
    for _ in range(10):
        os.write(far_end, garbage.randbytes(100))
    out, _ = told.communicate(timeout=60)
    os.close(far_end)
    os.close(near_end)
    assert told.returncode == 1
    assert re.search(r"no vehicle was heard in 5 s, but \d+ bytes that are no MAVLink; .*baud rate", out)


def test_a_port_in_use_and_a_missing_link_end_in_one_line(free_port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", free_port))
        told = gcs_coloc("doctor", "--seconds", "5", "--udp", f"127.0.0.1:{free_port}")
    assert told.returncode == 1
    assert told.stdout == ""
    (line,) = told.stderr.splitlines()
    assert line.startswith("gcs-coloc: error: udpin:")
    told = gcs_coloc("doctor", "--seconds", "5")
    assert told.returncode == 2
    assert len(told.stderr.strip().splitlines()) == 1
    assert "no link to listen on" in told.stderr
