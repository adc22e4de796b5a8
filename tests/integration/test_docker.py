"""The demo in containers on a real engine: what they did, what they get over, and what is in the image."""

from __future__ import annotations

import json
import re
from pathlib import Path

import containers
import pytest
from brokers import wait_until
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc import __version__
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

ROOT = containers.ROOT
GPS_INPUT = mavlink.MAVLINK_MSG_ID_GPS_INPUT.to_bytes(3, "little")
RUNNING = ["broker", "coloc", "uav1", "uav2", "uav3", "uav4"]
PATIENCE_S = 120.0
LOOK_INTO_THE_IMAGE = """
import importlib.metadata, json, pathlib, platform, shutil, sys
site = next(pathlib.Path(p) for p in sys.path if p.startswith("/opt/gcs-coloc") and p.endswith("site-packages"))
print(json.dumps({
    "python": {"python_full_version": platform.python_version(), "sys_platform": sys.platform},
    "versions": {d.metadata["Name"]: d.version for d in importlib.metadata.distributions(path=[str(site)])},
    "ours": [str(f.relative_to(site)) for p in ("gcs_coloc", "sitl_fakes") for f in (site / p).rglob("*")
             if f.is_file() and f.suffix != ".pyc"],
    "tests": [str(d) for d in site.rglob("tests")],
    "state": [str(f) for f in pathlib.Path("/var/lib/gcs-coloc").rglob("*") if f.is_file()],
    "source": pathlib.Path("/src").exists(),
    "compilers": [c for c in ("cc", "gcc", "g++", "clang", "make", "ld") if shutil.which(c)],
}))
"""


@pytest.fixture(scope="module")
def demo():
    lacking = containers.missing()
    if lacking is not None:
        pytest.skip(f"the containers are not tested: {lacking}")
    demo = containers.Demo()
    try:
        demo.build("coloc")
        demo.said = demo.run("make", "demo-docker")
        yield demo
    finally:
        demo.compose("down", "--volumes", "--remove-orphans", "--timeout", "5")
        demo.run("docker", "image", "prune", "--force", "--filter", "label=org.opencontainers.image.title=gcs-coloc")
    assert demo.left() == []


def located(demo) -> dict:
    """UAV4's next estimate once it is being sent its position."""
    while not demo.published("4/state")["aiding_has_fix"]:
        pass
    return demo.published("4/estimate")


def fly_on(demo) -> None:
    """Wait until UAV4 says that it navigates on what it is sent, after it was located."""
    since = f"{located(demo)['at_unix_s']:.3f}"
    aircraft = demo.container("uav4")
    wait_until(lambda: "4 gps2 injected" in demo.log(aircraft, since), PATIENCE_S)


def test_one_command_leads_to_a_located_uav4_that_flies_on_what_it_is_sent(demo):
    assert re.search(r"The page: http://127\.0\.0\.1:\d+/", demo.said)
    assert re.search(r"UAV4 has lost its GPS and is located: 1-sigma \d+\.\d m, from ranges to 3 neighbours, HDOP", demo.said)
    assert re.search(r"UAV4 flies on it: t = \d+ s: 4 gps2 injected \d+ m off route", demo.said)
    assert demo.published("4/health")["gps_state"] == "failed"
    estimate = located(demo)
    assert estimate["ranges_in_use"] == 3
    # Ranges of 20 m and peers' GPS of 15 m, both white: 2 to 7 m over this flight. Far more or less is no filter at work.
    assert 0.5 < estimate["sigma_h_m"] < 20.0
    assert demo.published("status")["vehicles"] == [1, 2, 3, 4]
    networks = [demo.inspect(f"uav{n}")["NetworkSettings"]["Networks"] for n in range(1, 5)]
    assert len({network["IPAddress"] for of_one in networks for network in of_one.values()}) == 4


def test_the_page_and_the_metrics_answer_on_the_host(demo):
    assert "<title>gcs-coloc" in demo.fetch(demo.page())
    assert demo.fetch(f"{demo.page()}readyz") == "ok\n"
    assert 'gcs_coloc_vehicle_gps_state{state="failed",sysid="4"} 1.0' in demo.fetch(f"{demo.page()}metrics")


def test_containers_run_without_root_without_capabilities_and_cannot_write_their_files(demo):
    for service in [*RUNNING, "secrets"]:
        host = demo.inspect(service)["HostConfig"]
        assert (host["CapDrop"], host["ReadonlyRootfs"], host["Privileged"]) == (["ALL"], True, False), service
    for service in RUNNING:
        status = dict(line.split(":", 1) for line in demo.in_container(service, "cat", "/proc/1/status").splitlines())
        assert status["Uid"].split() == ["10001"] * 4, service
        assert {int(status[kind], 16) for kind in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {0}, service
        assert status["NoNewPrivs"].strip() == "1", service
    ports = demo.inspect("coloc")["NetworkSettings"]["Ports"]
    assert [binding["HostIp"] for bindings in ports.values() for binding in bindings or []] == ["127.0.0.1"]


def test_nobody_gets_to_the_broker_without_the_password(demo):
    wrong = ["mosquitto_sub", "-u", "gcs-coloc", "-P", "guess", "-t", "#", "-C", "1", "-W", "5"]
    with pytest.raises(AssertionError, match=r"not authori[sz]ed"):
        demo.in_container("broker", *wrong)


def test_a_broker_that_dies_comes_back_and_the_service_finds_it_again(demo):
    before = {service: demo.inspect(service)["RestartCount"] for service in ("broker", "coloc")}
    demo.kill("broker")
    wait_until(lambda: demo.inspect("broker")["RestartCount"] == before["broker"] + 1 and demo.is_healthy("broker"), PATIENCE_S)
    assert demo.published("status")["online"] is True
    assert located(demo)["no_estimate_reason"] is None
    assert demo.inspect("coloc")["RestartCount"] == before["coloc"]


def test_a_service_that_dies_comes_back_and_the_aid_goes_on(demo):
    before = demo.inspect("coloc")["RestartCount"]
    demo.kill("coloc")
    wait_until(lambda: demo.inspect("coloc")["RestartCount"] == before + 1 and demo.is_healthy("coloc"), PATIENCE_S)
    fly_on(demo)


def test_sigterm_ends_the_service_within_two_seconds_with_a_last_message_without_a_fix(demo, tmp_path):
    fly_on(demo)
    container = demo.container("coloc")
    demo.run("docker", "stop", "--time", "2", container)
    ended = demo.inspect("coloc")["State"]
    assert ended["ExitCode"] == 0  # after two seconds the engine would have killed it: 137
    demo.run("docker", "cp", f"{container}:/var/lib/gcs-coloc/recordings", str(tmp_path))
    *stream, last = sent_gps_inputs(max((tmp_path / "recordings").glob("*.tlog")))
    assert any(message.fix_type == 3 for message in stream)
    assert (last.fix_type, last.time_usec) == (1, 0)  # a fix withheld in flight has a time: UTC is known by then
    wait_until(lambda: "4 dead_reckoning" in demo.log(demo.container("uav4"), ended["FinishedAt"]), PATIENCE_S)
    demo.run("docker", "start", container)
    wait_until(lambda: demo.is_healthy("coloc"), PATIENCE_S)
    fly_on(demo)


def sent_gps_inputs(tlog: Path) -> list[mavlink.MAVLink_gps_input_message]:
    frames = [record.frame for record in TlogReader(tlog)]
    return [mavlink.MAVLink(None).parse_char(frame) for frame in frames if frame[7:10] == GPS_INPUT]


def test_the_image_holds_the_locked_versions_our_packages_and_nothing_else_of_ours(demo):
    found = json.loads(demo.run("docker", "run", "--rm", "--entrypoint=python", "gcs-coloc", "-c", LOOK_INTO_THE_IMAGE))
    lines = (line for line in (ROOT / "requirements.lock").read_text().splitlines() if line and line[0].isalnum())
    locked = [Requirement(line.rstrip(" \\")) for line in lines]
    here = {r.name: str(r.specifier).removeprefix("==") for r in locked if r.marker is None or r.marker.evaluate(found["python"])}
    assert {canonicalize_name(name): version for name, version in found["versions"].items()} == {**here, "gcs-coloc": __version__}
    tracked = demo.run("git", "ls-files", "--cached", "--others", "--exclude-standard", "gcs_coloc", "sitl_fakes").split()
    assert sorted(found["ours"]) == sorted(tracked)
    for nothing in ("tests", "state", "compilers"):
        assert found[nothing] == [], nothing
    assert not found["source"]


def test_in_the_field_the_service_runs_alone_on_the_hosts_network(demo, free_port):
    own = ["-e", f'GCS_COLOC_LINKS=["udpin:127.0.0.1:{free_port}"]', "-e", "GCS_COLOC_WEB__ADDRESS=127.0.0.1:0"]
    container = demo.compose("--profile", "field", "run", "--detach", *own, "field", SERIAL_DEVICE="/dev/null").split()[-1]
    address = re.compile(r"web page: (http://127\.0\.0\.1:\d+/)")
    wait_until(lambda: address.search(demo.log(container)), PATIENCE_S)
    (page,) = address.findall(demo.log(container))
    assert demo.fetch(f"{page}readyz") == "ok\n"
    demo.run("docker", "stop", container)
    assert demo.run("docker", "inspect", "--format", "{{.State.ExitCode}}", container) == "0\n"
    demo.run("docker", "rm", container)
