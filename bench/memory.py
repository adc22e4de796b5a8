"""Memory over a long run: an hour of simulated flight through decoder, engine and encoder at full speed, in a process of its own.

`python -m bench.memory LAPS` is that process. It reads the datagrams of a minute from stdin, so that nothing of the
simulation is in it, and prints the resident megabytes after each lap as JSON.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys

from bench.figures import Figure
from bench.flight import Flight

_LAP_S = 60
_MOST_MB = 120.0


def measure(quick: bool) -> list[Figure]:
    """One minute of a fleet of four with a vehicle without GPS, played over and over on shifted clocks."""
    from bench.traffic import WARM_S, fleet_traffic

    laps = 10 if quick else 60
    minute = [(s.at_s - WARM_S, s.sysid, s.payload) for s in fleet_traffic(_LAP_S) if s.at_s >= WARM_S]
    process = [sys.executable, "-m", "bench.memory", str(laps)]
    sizes_mb = json.loads(subprocess.run(process, input=pickle.dumps(minute), capture_output=True, check=True).stdout)
    half, end = sizes_mb[len(sizes_mb) // 2], sizes_mb[-1]
    growth = end / half - 1.0
    return [
        Figure(
            f"growth over the second half of {laps} min", f"{growth:+.2%} ({half:.1f} -> {end:.1f} MB)", "<= 1 %", growth <= 0.01
        ),
        Figure(f"resident after {laps} min, without the page", f"{end:.0f} MB", f"<= {_MOST_MB:.0f} MB", end <= _MOST_MB),
    ]


def main() -> None:
    """Fly the laps. Each is a reboot of all vehicles: their clocks jump back, as they do once in a while over hours."""
    import gcs_coloc.service.service  # noqa: F401 - what the service has in memory besides the flight
    from bench.service_cpu import rss_mb
    from bench.traffic import Sent
    from gcs_coloc.mavlink.decoder import Decoder
    from gcs_coloc.runtime.process import exclude_start

    minute = [Sent(*entry) for entry in pickle.load(sys.stdin.buffer)]
    flight, sizes_mb = Flight(), []
    exclude_start()
    for lap in range(int(sys.argv[1])):
        flight.decoder = Decoder()
        flight.fly(sent._replace(at_s=sent.at_s + lap * _LAP_S) for sent in minute)
        sizes_mb.append(rss_mb("self"))
    print(json.dumps(sizes_mb))


if __name__ == "__main__":
    main()
