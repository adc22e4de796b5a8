"""The demo's picture: where the denied vehicle flew with and without the service, and how far its position was off."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.study.closed_loop import Flight, Sample
from sitl_fakes.scenario import Scenario


def draw(scenario: Scenario, denied_vehicle: int, lost_s: float, with_service: Flight, without: Flight, path: Path) -> None:
    """Write a PNG with the tracks on the left and, on one time axis on the right, error with its 95 % bound, and HDOP."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(12, 6.2), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1))
    track, error, route, hdop = (figure.add_subplot(grid[:, 0]), *(figure.add_subplot(grid[i, 1]) for i in range(3)))

    fleet = track.inset_axes((0.045, 0.04, 0.36, 0.36))
    for vehicle in scenario.vehicle:
        east, north = _track(with_service.samples[vehicle.sysid])
        fleet.plot(east, north, color="#0072b2" if vehicle.sysid == denied_vehicle else "0.5", lw=1)
        fleet.annotate(f"{vehicle.sysid}", (east[0], north[0]), fontsize=8)
    fleet.set_title("the fleet, km", fontsize=8)
    fleet.tick_params(labelsize=7)
    fleet.set_aspect("equal", adjustable="datalim")
    waypoints = np.array(next(v.waypoints for v in scenario.vehicle if v.sysid == denied_vehicle)) / 1e3
    track.plot(waypoints[:, 0], waypoints[:, 1], "k:", lw=1, marker="s", ms=4, label=f"UAV{denied_vehicle}: planned route")
    track.plot(*_track(without.samples[denied_vehicle]), color="#d55e00", lw=1.5, label="flown without the service")
    track.plot(*_track(with_service.samples[denied_vehicle]), color="#0072b2", lw=1.8, label="flown with the service")
    at_loss = next(s for s in with_service.samples[denied_vehicle] if s.at_s >= lost_s)
    track.plot(at_loss.truth.east_m / 1e3, at_loss.truth.north_m / 1e3, "kx", ms=9, mew=2, label="GPS lost")
    track.set(xlabel="east, km", ylabel="north, km", title=f"UAV{denied_vehicle}: planned and flown")
    track.set_aspect("equal", adjustable="datalim")
    track.grid(alpha=0.3)
    track.legend(fontsize=8, loc="lower right")

    known = [s for s in with_service.samples[denied_vehicle] if s.error_enu_m is not None and s.covariance is not None]
    times = [s.at_s for s in known]
    error.plot(times, [np.hypot(*s.error_enu_m[:2]) for s in known if s.error_enu_m is not None], color="#0072b2", lw=0.8)
    bound = [horizontal_bound_95_m(s.covariance) for s in known if s.covariance is not None]
    error.plot(times, bound, color="0.3", lw=1, ls="--", label="95 % bound")
    error.set(ylabel="position error, m", title=f"gcs-coloc's position of UAV{denied_vehicle}")
    error.legend(fontsize=8, loc="upper left")
    for flight, colour in ((without, "#d55e00"), (with_service, "#0072b2")):
        samples = flight.samples[denied_vehicle]
        route.plot([s.at_s for s in samples], [s.truth.off_route_m for s in samples], color=colour, lw=1)
    route.set(ylabel="off its route, m")
    with_hdop = [s for s in with_service.samples[denied_vehicle] if s.hdop is not None]
    hdop.plot([s.at_s for s in with_hdop], [s.hdop for s in with_hdop], color="#009e73", lw=1)
    hdop.set(ylabel="HDOP", xlabel="time, s", ylim=(0, 12))
    for axes in (error, route, hdop):
        axes.axvline(lost_s, color="k", lw=0.8)
        axes.set_xlim(0, scenario.duration_s)
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _track(samples: list[Sample]) -> tuple[list[float], list[float]]:
    return [s.truth.east_m / 1e3 for s in samples], [s.truth.north_m / 1e3 for s in samples]
