"""Locates a vehicle without GPS from its ranges to three anchors.

python examples/locate_from_ranges.py
"""

from math import dist

from gcs_coloc import AltitudeMeasurement, FleetFilter, NoEstimate, PositionMeasurement, RangeMeasurement

ANCHORS = {1: (0.0, 0.0, 2.0), 2: (100.0, 0.0, 2.0), 3: (0.0, 100.0, 2.0)}  # vehicle: east, north, up in metres

estimator = FleetFilter()
for vehicle, position in ANCHORS.items():
    estimator.add(PositionMeasurement(vehicle, 0.0, 0.0, position, sigma_h_m=0.1, sigma_v_m=0.1, static=True))
estimator.set_denied({4}, at_s=0.0)
for t in (0.2 * i for i in range(50)):
    true_position = (40.0 + 2.0 * t, 30.0, 10.0)  # flies east at 2 m/s
    estimator.add(AltitudeMeasurement(4, t, t, up_m=10.0, sigma_m=0.5))
    for vehicle, position in ANCHORS.items():
        estimator.add(RangeMeasurement(4, vehicle, t, t, range_m=dist(true_position, position), sigma_m=0.1))
answer = estimator.estimate(4, at_s=9.8)

if isinstance(answer, NoEstimate):
    print(f"no estimate: {answer.reason}")
else:
    east_m, north_m, up_m = answer.position_enu_m
    sigma_east_m = answer.covariance[0, 0] ** 0.5
    print(f"east {east_m:.2f} m, north {north_m:.2f} m, up {up_m:.2f} m, 1 sigma {sigma_east_m:.2f} m east")
