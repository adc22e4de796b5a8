"""Hashes every number that the engine and the estimators give out, to show that a change of the code changes none of them.

    python tools/output_hashes.py DIR... --save FILE       before the change
    python tools/output_hashes.py DIR... --compare FILE    after it; exits 1 where a hash differs

Below each DIR every recording (*.tlog) is replayed and every data set (meta.toml) is evaluated; three simulated flights are flown
as well. In the hash: estimates with covariance, the state of GPS health, the bytes of outbound messages. Not in it: wording.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import struct
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.messages.outbound import Outbound, ToVehicle
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.evaluation.evaluate import evaluate
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.recorder import replay as driver
from gcs_coloc.recorder.side_tables import read_ranges
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.study.closed_loop import fly
from sitl_fakes.scenario import SCENARIOS, load_scenario

LOOK_EVERY_S = 0.5
FLOWN_S = {"paper": 120.0, "two-failed": 90.0, "uwb": 120.0}
ESTIMATORS = ("fleet", "qu_zhang")


class OutputHash:
    """A hash of numbers and bytes in the order in which they came out."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def numbers(self, *values: float) -> None:
        """Add numbers, to the last bit."""
        self._hash.update(struct.pack(f"<{len(values)}d", *values))

    def raw(self, data: bytes) -> None:
        """Add bytes."""
        self._hash.update(data)

    def estimate(self, answer: object) -> None:
        """Add an estimator's answer: all its numbers, or a mark where it has none."""
        if isinstance(answer, Estimate):
            hdop = answer.hdop if answer.hdop is not None else -1.0
            for array in (answer.position_enu_m, answer.velocity_enu_mps, answer.covariance):
                self.raw(array.tobytes())
            self.numbers(hdop, answer.ranges_in_use)
        else:
            self.raw(b"-")

    def engine(self, engine: Engine, now_s: float) -> None:
        """Add the engine's answers about all vehicles."""
        for vehicle in engine.snapshot(now_s).vehicles:
            self.numbers(now_s, vehicle.sysid)
            self.raw(vehicle.gps_state.encode())
            self.estimate(engine.estimate(vehicle.sysid, now_s))

    def digest(self) -> str:
        """Return the hash as text."""
        return self._hash.hexdigest()[:24]


def of_recording(file: Path, estimator: str) -> str:
    """Replay a recording; the ranges beside it are given to the engine as well."""
    result, encoder = OutputHash(), Encoder()
    table = file.with_name("ranges.csv")
    ranges: list[PeerRange] = read_ranges(table) if table.exists() else []
    engine = Engine(load_estimator(estimator, {}))

    def polled(at_s: float, outputs: list[Outbound]) -> None:
        for output in outputs:
            if isinstance(output, ToVehicle):
                result.numbers(at_s)
                result.raw(encoder.encode(output, output.sysid))

    through = driver.Replay(engine, TlogReader(file), ranges, polled)
    start_s = through.next_s or 0.0

    def looks() -> Iterator[float]:
        at_s = start_s
        while through.next_s is not None:
            at_s += LOOK_EVERY_S
            yield at_s

    driver.replay(through, looks(), lambda at_s: result.engine(engine, at_s))
    return result.digest()


def of_dataset(directory: Path, estimator: str) -> str:
    """Evaluate a data set."""
    result = OutputHash()
    try:
        evaluation = evaluate(directory, load_estimator(estimator, {}), cpu_s=lambda: 0.0)
    except Exception as error:  # what stops an estimator today is hashed as well
        result.raw(type(error).__name__.encode())
        return result.digest()
    for vehicle in evaluation.denied:
        for array in (vehicle.series.times_s, vehicle.series.estimate_enu_m, vehicle.series.covariance_m2, vehicle.nis):
            result.raw(array.tobytes())
    return result.digest()


def of_simulation(scenario: Path, estimator: str) -> str:
    """Fly a scenario in a closed loop with the engine."""
    result = OutputHash()
    flight = fly(load_scenario(scenario), 7, Engine(load_estimator(estimator, {})), duration_s=FLOWN_S[scenario.stem])
    for sysid, samples in sorted(flight.samples.items()):
        for sample in samples:
            result.numbers(sysid, sample.at_s, sample.truth.lat_deg, sample.truth.lon_deg)
            result.raw(sample.gps_state.encode())
            for array in (sample.error_enu_m, sample.covariance):
                result.raw(array.tobytes() if array is not None else b"-")
    result.numbers(*flight.gps_inputs.values())
    return result.digest()


def main() -> int:
    """Compute all hashes on all cores, and save or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("directories", nargs="*", type=Path)
    parser.add_argument("--save", type=Path)
    parser.add_argument("--compare", type=Path)
    parser.add_argument("--only", default="", help="only what has this text in its name")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    tasks: list[tuple[str, Callable[[Path, str], str], Path, str]] = []
    for estimator in ESTIMATORS:
        tasks += [
            (f"{estimator} flown scenario-{name}", of_simulation, SCENARIOS / f"{name}.toml", estimator)
            for name in sorted(FLOWN_S)
        ]
        for directory in arguments.directories:
            logs = [file.relative_to(directory) for file in sorted(directory.rglob("*.tlog"))]
            sets = [file.parent.relative_to(directory) for file in sorted(directory.rglob("meta.toml"))]
            tasks += [(f"{estimator} replayed {file}", of_recording, directory / file, estimator) for file in logs]
            tasks += [(f"{estimator} evaluated {name}", of_dataset, directory / name, estimator) for name in sets]
    tasks = [task for task in tasks if arguments.only in task[0]]
    hashes: dict[str, str] = {}
    with ProcessPoolExecutor(arguments.processes) as pool:
        running = [(name, pool.submit(function, path, estimator)) for name, function, path, estimator in tasks]
        for name, future in running:
            hashes[name] = future.result()
            print(hashes[name], name, flush=True)
    if arguments.save is not None:
        arguments.save.write_text(json.dumps(hashes, indent=1) + "\n", encoding="utf-8")
    if arguments.compare is None:
        return 0
    before = json.loads(arguments.compare.read_text(encoding="utf-8"))
    changed = [name for name, digest in hashes.items() if before.get(name) != digest]
    missing = [name for name in before if name not in hashes and arguments.only in name]
    for name in changed + missing:
        print(f"CHANGED {name}", file=sys.stderr)
    print(f"{len(hashes)} hashes, {len(changed) + len(missing)} changed")
    return 1 if changed or missing else 0


if __name__ == "__main__":
    sys.exit(main())
