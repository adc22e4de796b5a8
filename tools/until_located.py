"""Waits until a vehicle is sent its position, and says in one line how well it is located. Runs where the service runs.

`docker compose exec -T coloc python - SYSID < tools/until_located.py`
"""

import sys
import time
import urllib.request

from prometheus_client.parser import text_string_to_metric_families

_METRICS = "http://127.0.0.1:8080/metrics"
_PATIENCE_S = 240.0
_FIX, _SIGMA_M = "gcs_coloc_vehicle_aiding_fix", "gcs_coloc_vehicle_position_sigma_meters"
_PEERS, _HDOP = "gcs_coloc_vehicle_ranges_in_use", "gcs_coloc_vehicle_hdop"


def _of_vehicle(sysid: str) -> dict[str, float]:
    """The metrics of a vehicle; none while the page does not answer, as on a busy computer."""
    try:
        with urllib.request.urlopen(_METRICS, timeout=10) as answer:
            text = answer.read().decode()
    except OSError:
        return {}
    families = text_string_to_metric_families(text)
    return {s.name: s.value for family in families for s in family.samples if s.labels.get("sysid") == sysid}


def main(sysid: str) -> None:
    """Wait for the vehicle; exit code 1 where it comes to nothing."""
    end = time.monotonic() + _PATIENCE_S
    # A position that has just been lost may still be the last that was sent.
    while not ((now := _of_vehicle(sysid)).get(_FIX) == 1.0 and now.keys() >= {_SIGMA_M, _PEERS, _HDOP}):
        if time.monotonic() > end:
            sys.exit(f"UAV{sysid} was not located within {_PATIENCE_S:.0f} s; what the service says: docker compose logs coloc")
        time.sleep(0.5)
    print(
        f"UAV{sysid} has lost its GPS and is located: 1-sigma {now[_SIGMA_M]:.1f} m, "
        f"from ranges to {now[_PEERS]:.0f} neighbours, HDOP {now[_HDOP]:.1f}"
    )


main(sys.argv[1])
