"""From the command to the first datagram that is taken: a vehicle's heartbeats are sent until the log tells of it."""

from __future__ import annotations

import compileall
import os
import re
import socket
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from pymavlink.dialects.v20 import ardupilotmega as mavlink

import gcs_coloc
from bench.figures import Figure
from bench.free_ports import free_port
from bench.service_cpu import cpu_s

_GOAL_S = 1.0
_GIVE_UP_S = 60.0
_ALONE = ("--no-web",)
_UNIT = Path(__file__).parent.parent / "configs" / "gcs-coloc.service"
_COMPUTES = "import os; starter = os.getppid()\nwhile os.getppid() == starter: sum(range(100_000))"


def measure(quick: bool) -> list[Figure]:
    """Starts by turns with bare ones; then with nothing of the environment in the page cache, and beside busy processes."""
    # As an installer does; a source tree may have none, or an old one, where Python is told to write none.
    compileall.compile_dir(Path(gcs_coloc.__file__).parent, quiet=1)
    warm, with_page, bare = [], [], []
    for _ in range(3 if quick else 10):
        bare.append(_bare())
        warm.append(_start(_ALONE))
        with_page.append(_start(["--web", "127.0.0.1:0"]))
    cold = []
    for _ in range(1 if quick else 5):
        _drop_cached()
        cold.append(_start(_ALONE))
    repeats = range(1 if quick else 5)
    with _busy(count := os.cpu_count() or 1):
        busy = [_start(_ALONE) for _ in repeats]
        as_unit = [_start(_ALONE, _unit_priority()) for _ in repeats] if _may_raise_priority() else []
    bare_s = median(bare)
    beside = f"beside {count} busy process{'es' if count > 1 else ''}"
    times = f"{median(wall for wall, _ in warm) / bare_s:.1f} times importing numpy alone ({bare_s:.2f} s)"
    return [
        _figure("to the first datagram taken, without the page", warm, f", {times}"),
        _figure("the same, nothing of the environment in the page cache", cold),
        _figure(f"the same, {beside}", busy),
        _figure(f"the same, {beside}, at the priority of the systemd unit", as_unit),
        _figure("with the page", with_page),
    ]


def _figure(name: str, starts: Sequence[tuple[float, float]], more: str = "") -> Figure:
    if not starts:
        return Figure(name, "needs the right to raise a priority")
    walls, cpu = [wall for wall, _ in starts], median(used for _, used in starts)
    value = (
        f"median {median(walls):.2f} s, most {max(walls):.2f} s, least {min(walls):.2f} s of {len(walls)} (CPU {cpu:.2f} s){more}"
    )
    return Figure(name, value, f"<= {_GOAL_S:.1f} s", median(walls) <= _GOAL_S)


def _drop_cached() -> None:
    """Have the kernel forget what it holds of the files of Python, its packages and the program, as after a boot.

    Pages that another process has mapped stay, as those of the interpreter itself.
    """
    os.sync()  # a page that is not written yet is not dropped
    paths = sysconfig.get_paths()
    ours = {Path(paths[name]) for name in ("purelib", "platlib")} | {Path(gcs_coloc.__file__).parent}
    # Python's own directory may hold packages of another environment.
    own = (path for path in Path(paths["stdlib"]).rglob("*") if "site-packages" not in path.parts)
    for path in (*own, *(path for root in ours for path in root.rglob("*"))):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """So many processes that compute all the time, and end with this one."""
    processes = [subprocess.Popen([sys.executable, "-c", _COMPUTES]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _unit_priority() -> list[str]:
    """What comes before a command so that it runs at the priority of the systemd unit."""
    (nice,) = re.findall(r"^Nice=(-?\d+)$", _UNIT.read_text(encoding="utf-8"), re.MULTILINE)
    return ["nice", "-n", nice]


def _may_raise_priority() -> bool:
    return os.geteuid() == 0


def _start(arguments: Sequence[str], before: Sequence[str] = ()) -> tuple[float, float]:
    """Wall and CPU seconds of one start."""
    port = free_port()
    frames = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    began_s = time.monotonic()
    service = subprocess.Popen(
        [*before, sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", *arguments],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    assert service.stderr is not None
    os.set_blocking(service.stderr.fileno(), False)
    told = b""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            while b"heard for the first time" not in told:
                if time.monotonic() - began_s > _GIVE_UP_S:
                    raise RuntimeError(f"the service did not start: {told.decode()}")
                frames.seq = (frames.seq + 1) & 0xFF
                vehicle.sendto(heartbeat.pack(frames), ("127.0.0.1", port))
                time.sleep(0.005)
                told += service.stderr.read() or b""
        return time.monotonic() - began_s, cpu_s(service.pid)
    finally:
        service.terminate()
        service.communicate(timeout=20)


def _bare() -> float:
    began_s = time.monotonic()
    subprocess.run([sys.executable, "-c", "import numpy"], check=True)
    return time.monotonic() - began_s
