"""Scenario files: those that ship are valid, wrong ones are refused by name; the command line says one line and no traceback."""

from __future__ import annotations

import csv
import math
import os
import signal
import socket
import subprocess
import sys
import tomllib

import pytest

from gcs_coloc.recorder.side_tables import read_truth
from sitl_fakes import cli
from sitl_fakes.fleet import Fleet
from sitl_fakes.guidance import PAPER_ROUTES
from sitl_fakes.scenario import SCENARIOS, ScenarioError, load_scenario
from tests.unit.sitl_fakes.fakes_support import aid

GOOD = 'name = "x"\n[origin]\nlat_deg = 47.0\nlon_deg = 8.0\n[[vehicle]]\nsysid = 1\nwaypoints = [[0, 0], [0, 1000]]\n'
SHIPPED = sorted(SCENARIOS.glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_the_shipped_scenarios_load_and_fly(path):
    scenario = load_scenario(path)
    fleet = Fleet(scenario, 1)
    fleet.advance(3.0)
    assert set(fleet.truth()) == {v.sysid for v in scenario.vehicle}
    assert all(t.source == "gps1" for t in fleet.truth().values())


def test_the_papers_scenario_is_the_papers():
    scenario = load_scenario("paper")
    assert [tuple(v.waypoints) for v in scenario.vehicle] == list(PAPER_ROUTES)
    assert (scenario.airspeed_mps, scenario.gps.sigma_h_m, scenario.ranging.sigma_m) == (50.0, 15.0, 20.0)
    assert [scenario.ranging_peers(v) for v in scenario.vehicle] == [[], [], [], [1, 2, 3]]
    assert [(f.kind, f.vehicle, f.at_s) for f in scenario.fault] == [("gps_lost", 4, 20.0)]


def test_in_the_scenario_with_two_failed_each_ranges_to_the_other():
    scenario = load_scenario("two-failed")
    peers = {v.sysid: scenario.ranging_peers(v) for v in scenario.vehicle}
    assert peers[4] == [1, 2, 3, 5]
    assert peers[5] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (GOOD + "speed = 3\n", r"vehicle\.0\.speed"),
        ("tempo = 1\n" + GOOD, "tempo"),
        (GOOD.replace("47.0", "97.0"), r"origin\.lat_deg"),
        (GOOD.replace("47.0", "nan"), r"origin\.lat_deg"),
        (GOOD.replace("sysid = 1", "sysid = 0"), r"vehicle\.0\.sysid"),
        (GOOD.replace("[0, 1000]", "[0, 0]"), "successive waypoints are equal"),
        (GOOD.replace(", [0, 1000]", ""), r"vehicle\.0\.waypoints"),
        (GOOD + "ranges_to = [7]\n", "cannot range to 7"),
        (GOOD + "params = { EK3_TYPO = 1 }\n", "no such parameter: EK3_TYPO"),
        (GOOD + "[[vehicle]]\nsysid = 1\nwaypoints = [[0, 0], [1, 1]]\n", "same sysid"),
        (GOOD + '[[fault]]\nkind = "gps_lost"\nvehicle = 2\nat_s = 1\n', "vehicle 2"),
        (GOOD + '[[fault]]\nkind = "gps_gone"\nvehicle = 1\nat_s = 1\n', "gps_gone"),
        (GOOD + '[[fault]]\nkind = "gps_lost"\nvehicle = 1\nat_s = 5\nuntil_s = 2\n', "until_s must be later"),
        (GOOD + '[[fault]]\nkind = "reboot"\nvehicle = 1\nat_s = 5\nuntil_s = 9\n', "takes no until_s"),
        ("name = ", "not valid TOML"),
        (f"duration_s = {'9' * 5000}", "not valid TOML"),
        (f"name = {'[' * 3000}", "not valid TOML"),
        ("", "name"),
    ],
)
def test_a_wrong_scenario_is_refused_with_file_and_key(tmp_path, text, says):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=says) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def run_cli(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["sitl-fakes", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return caught.value.code, capsys.readouterr().err


PAPER = SCENARIOS / "paper.toml"


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["missing.toml"], 2, "missing.toml: no such file, and no scenario of that name; see sitl-fakes --list"),
        (["."], 2, ".: cannot be read: Is a directory"),
        ([], 2, "Missing argument"),
        (["--nonsense"], 2, "nonsense"),
        ([PAPER, "--target", "nowhere"], 2, "expected HOST:PORT"),
        ([PAPER, "--target", "127.0.0.1:99999"], 2, "expected HOST:PORT"),
        ([PAPER, "--seed", "-1"], 2, "--seed"),
        ([PAPER, "--duration", "x"], 2, "--duration"),
        ([PAPER, "--vehicle", "9"], 2, "--vehicle 9"),
        ([PAPER, "--vehicle", "4", "--airspace", "10.0.0.1:14600"], 2, "expected an IPv4 multicast group"),
        ([PAPER, "--vehicle", "4", "--airspace", "239.255.40.4"], 2, "--airspace '239.255.40.4': expected HOST:PORT"),
        ([PAPER, "--airspace", "239.255.40.4:14600"], 2, "with --vehicle"),
        ([PAPER, "--vehicle", "4", "--airspace", "239.255.40.4:14600", "--target", "[::1]:9"], 1, "cannot join the multicast"),
        ([PAPER, "--truth", "/no/such/dir/t.csv"], 1, "cannot write /no/such/dir/t.csv"),
    ],
)
def test_a_wrong_command_line_ends_in_one_line_and_its_code(monkeypatch, capsys, arguments, code, says):
    got, err = run_cli(monkeypatch, capsys, *arguments)
    assert got == code
    assert says in err
    assert err.count("\n") == 1


def test_a_port_in_use_is_said_in_one_line(monkeypatch, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        base = taken.getsockname()[1] - 1
        code, err = run_cli(monkeypatch, capsys, PAPER, "--port-base", base, "--vehicle", 1)
    assert code == 1
    assert f"cannot use UDP port {base + 1}" in err.splitlines()[-1]


@pytest.mark.integration
def test_the_program_sends_from_a_socket_per_vehicle_writes_the_truth_and_stops_on_a_signal(tmp_path):
    truth = tmp_path / "truth.csv"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(20.0)
        target = f"127.0.0.1:{ground.getsockname()[1]}"
        program = subprocess.Popen(
            [sys.executable, "-m", "sitl_fakes.cli", str(PAPER), "--target", target, "--truth", str(truth)],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            senders: dict[int, set[tuple[str, int]]] = {}
            for _ in range(300):
                payload, address = ground.recvfrom(2048)
                senders.setdefault(payload[5], set()).add(address)
        finally:
            os.kill(program.pid, signal.SIGTERM)
            _, err = program.communicate(timeout=20.0)
    assert program.returncode == 0
    assert "Traceback" not in err
    assert "4 gps1" in err
    assert set(senders) == {1, 2, 3, 4}
    assert all(len(addresses) == 1 for addresses in senders.values())
    assert len(set.union(*senders.values())) == 4
    rows = list(csv.DictReader(truth.read_text().splitlines()))
    assert {row["sysid"] for row in rows} == {"1", "2", "3", "4"}
    assert float(rows[-1]["at_s"]) > 0.0
    assert {round(float(row["unix_s"]) - float(row["at_s"]), 2) for row in rows} == {round(read_truth(truth)[0].unix_s, 2)}


def test_the_configs_are_plain_toml():
    assert len(SHIPPED) >= 3
    for path in SHIPPED:
        assert tomllib.loads(path.read_text())["name"] in path.stem


def test_with_true_positions_injected_the_lost_vehicle_knows_where_it_is_and_without_it_does_not():
    """UAV4 of the paper's scenario from the loss at 20 s to 100 s, past its first turn: error of its own estimate."""
    paper = load_scenario(PAPER)
    uav4 = paper.vehicle[3].model_copy(update={"ranges_to": []})
    alone = paper.model_copy(update={"vehicle": [uav4]})
    worst = {}
    for aided in (True, False):
        fleet = Fleet(alone, 2)
        fleet.advance(20.0)
        errors = []
        for second in range(20, 100):
            if aided:
                aid(fleet, 4, second, second + 1.0)
            else:
                fleet.advance(second + 1.0)
            t = fleet.truth()[4]
            errors.append(math.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m))
        worst[aided] = max(errors)
    assert worst[True] < 8.0
    assert worst[False] > 20.0


def test_the_scenarios_that_come_with_the_program_are_listed_and_flown_by_name(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["sitl-fakes", "--list"])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    listed = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in listed] == [path.stem for path in SHIPPED] == ["paper", "stations", "two-failed", "uwb"]
    assert all(load_scenario(name).description == description for name, description in listed)
