import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from gcs_coloc.core.measurements import AltitudeMeasurement, Estimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
from gcs_coloc.study.paper_filters import KINDS, PaperFilters, draw, predict, process_noise, update
from gcs_coloc.study.paper_options import PaperOptions, QForm, QUnit

H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
OPTIONS = PaperOptions(seeds=2, qs=(2.0, 30.0), figure_q=2.0)


def flight(steps: int) -> tuple[np.ndarray, np.ndarray]:
    start = np.array([[0.0, 0], [8000, 0], [7000, 8000], [2000, -4000]])
    velocity = np.array([[0.0, 50], [-22, 44], [-48, 12], [50, 0]])
    times = 0.02 * np.arange(steps + 1)
    return start[:, np.newaxis] + velocity[:, np.newaxis] * times[:, np.newaxis], np.repeat(velocity[:, np.newaxis], steps + 1, 1)


def plain_filter(position: np.ndarray, velocity: np.ndarray) -> KalmanFilter:
    kf = KalmanFilter(dim_x=4, dim_z=2)
    kf.x = np.array([[position[0]], [velocity[0]], [position[1]], [velocity[1]]])
    kf.P = np.diag([225.0, 1.0, 225.0, 1.0])
    kf.F = np.array([[1, 0.02, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1.0]])
    kf.H = H
    return kf


@pytest.mark.parametrize("kind", KINDS)
def test_all_draws_and_q_at_once_are_the_papers_equations_one_by_one(kind: str) -> None:
    # The paper's equations written out with plain inverses and filterpy's filters, for one draw and one q.
    positions, velocities = flight(60)
    draws = [draw(positions, velocities, seed, OPTIONS) for seed in (5, 6)]
    constant = np.stack([np.diag([900.0, 2000.0]), np.diag([1000.0, 2500.0])])
    filters = PaperFilters(draws, constant, OPTIONS)
    one, q = draws[1], 30.0
    uavs = [plain_filter(one.gps_m[i, 0], one.start_velocity_mps[i]) for i in range(4)]
    Q = np.diag([0, q, 0, q])
    for k in range(1, 61):
        step = filters.step(k)
        for i in range(3):
            uavs[i].predict(Q=Q)
            uavs[i].update(one.gps_m[i, k].reshape(2, 1), R=225.0 * np.eye(2))
        uavs[3].predict(Q=Q)
        centres = np.array([(H @ uavs[i].x)[:, 0] for i in range(3)])
        rho, place = one.ranges_m[:, k], (H @ uavs[3].x)[:, 0]
        inverse = np.linalg.inv(np.column_stack([-2 * centres, np.ones(3)]))
        fix = (inverse @ (rho**2 - (centres**2).sum(axis=1)))[:2]
        u = (place - centres) / np.linalg.norm(place - centres, axis=1, keepdims=True)
        s2 = np.array([u[i] @ H @ uavs[i].P @ H.T @ u[i] for i in range(3)])
        H1 = np.linalg.inv(np.column_stack([u, np.ones(3)]))
        spread = np.diag(4 * (rho**2 * 400.0 + ((place - centres) ** 2).sum(axis=1) * s2))
        R = {
            "general": constant[1],
            "published": np.diag(np.diag(H1 @ np.diag(s2) @ H1.T)[:2]),
            "published_with_range_noise": np.diag(np.diag(H1 @ np.diag(s2 + 400.0) @ H1.T)[:2]),
            "corrected": (inverse @ spread @ inverse.T)[:2, :2],
        }[kind]
        uavs[3].update(fix.reshape(2, 1), R=R)
        assert step.fix_m[1, 1] == pytest.approx(fix, rel=1e-6)

    at = KINDS.index(kind)
    assert step.state[at, 1, 1] == pytest.approx(uavs[3].x[:, 0], rel=1e-6)
    assert step.covariance[at, 1, 1] == pytest.approx(uavs[3].P, rel=1e-6)


def test_the_live_estimator_gives_the_same_on_synchronous_measurements() -> None:
    options = PaperOptions(seeds=1, qs=(2.0,), figure_q=2.0, q_form=QForm.ACCELERATION)
    positions, velocities = flight(100)
    one = draw(positions, velocities, 9, options)
    filters = PaperFilters([one], np.eye(2)[np.newaxis], options)
    live = QuZhangFilter(QuZhangSettings(q_m2ps2=2.0, lasting_peer_errors=False, gate_probability=1.0 - 1e-12))

    def position(uav: int, k: int) -> PositionMeasurement:
        (e, n), (ve, vn), t = one.gps_m[uav, k].tolist(), one.start_velocity_mps[uav].tolist(), 0.02 * k
        known = k == 0
        speed = ((ve, vn, 0.0), 1.0) if known else (None, None)
        return PositionMeasurement(uav + 1, t, t, (e, n, 0.0), 15.0, 1e-6, *speed)

    for uav in range(4):
        live.add(position(uav, 0))
    live.set_denied([4], 0.0)
    # A vehicle that turns denied vehicle keeps its receiver's lasting error; the paper's starts from the same fix without.
    live._tracks[4].horizontal.add_position_variance(-(15.0**2))  # type: ignore[union-attr]
    for k in range(1, 101):
        step = filters.step(k)
        live.add(AltitudeMeasurement(4, 0.02 * k, 0.02 * k, 0.0, 1e-6))
        for uav in range(3):
            live.add(position(uav, k))
        for uav in range(3):
            live.add(RangeMeasurement(4, uav + 1, 0.02 * k, 0.02 * k, float(one.ranges_m[uav, k]), 20.0))
    answer = live.estimate(4, 2.0)

    assert isinstance(answer, Estimate)
    assert live.counts()["fix used"] == 100
    expected = step.state[KINDS.index("corrected"), 0, 0]
    assert answer.position_enu_m[:2] == pytest.approx(expected[[0, 2]], abs=0.02)
    assert answer.velocity_enu_mps[:2] == pytest.approx(expected[[1, 3]], abs=0.02)
    covariance = step.covariance[KINDS.index("corrected"), 0, 0]
    assert answer.covariance[0, 0] == pytest.approx(covariance[0, 0], rel=1e-3)


def test_an_observation_that_is_not_finite_changes_nothing() -> None:
    state, P = np.array([[1.0, 2, 3, 4]]), np.diag([1.0, 2, 3, 4])[np.newaxis]
    for z, R in ((np.array([[np.nan, 0]]), np.eye(2)[np.newaxis]), (np.zeros((1, 2)), np.full((1, 2, 2), np.inf))):
        after, covariance = update(state, P, z, R)
        assert after.tolist() == state.tolist()
        assert covariance.tolist() == P.tolist()


def test_prediction_is_the_constant_velocity_step() -> None:
    F = np.array([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1.0]])
    state, P = predict(np.array([[1.0, 2, 3, 4]]), np.eye(4)[np.newaxis], F, np.zeros((4, 4)))

    assert state[0] == pytest.approx([2, 2, 5, 4])
    assert P[0] == pytest.approx(F @ F.T)


def test_noise_has_the_size_that_the_options_state() -> None:
    # 4 x 3,001 x 2 normal values: their standard deviation is known to 15 / sqrt(2 x 24,000) = 0.07 m; 4 of these.
    positions, velocities = flight(3000)
    one = draw(positions, velocities, 1, OPTIONS)

    assert (one.gps_m - positions).std() == pytest.approx(15.0, abs=0.28)
    true = np.linalg.norm(positions[3] - positions[:3], axis=-1)
    assert (one.ranges_m - true).std() == pytest.approx(20.0, abs=0.6)
    assert draw(positions, velocities, 1, OPTIONS).gps_m.tolist() == one.gps_m.tolist()


def test_the_readings_of_q() -> None:
    per_step = PaperOptions()
    assert np.diag(process_noise(5.0, per_step)).tolist() == pytest.approx([0, 5, 0, 5])
    as_density = PaperOptions(q_unit=QUnit.DENSITY)
    assert np.diag(process_noise(5.0, as_density)) == pytest.approx([0, 0.1, 0, 0.1])
    acceleration = process_noise(5.0, PaperOptions(q_form=QForm.ACCELERATION))
    assert acceleration[0, 0] == pytest.approx(250.0 * 0.02**3 / 3)
    assert acceleration[1, 1] == pytest.approx(5.0)
