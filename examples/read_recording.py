"""Reads a recorded flight (tlog) into numpy arrays.

python examples/read_recording.py flight.tlog
"""

import sys

import numpy as np

from gcs_coloc import read_recording

if len(sys.argv) != 2:
    sys.exit("usage: python examples/read_recording.py flight.tlog")
recording = read_recording(sys.argv[1])
for sysid, vehicle in recording.vehicles.items():
    known = ~np.isnan(vehicle.enu_m[:, 0])
    apart_m = np.linalg.norm(vehicle.enu_m[known] - vehicle.reported_enu_m[known], axis=1)
    states = ", ".join(
        f"{state} {share:.0%}" for state in np.unique(vehicle.gps_state) if (share := np.mean(vehicle.gps_state == state))
    )
    print(f"vehicle {sysid}: {len(vehicle.unix_s)} rows, GPS {states}, median |estimate - report| {np.nanmedian(apart_m):.2f} m")
used = recording.residuals[:, 5] == 1.0
print(f"{len(used)} ranges, {np.mean(used) if len(used) else 0.0:.0%} used")
