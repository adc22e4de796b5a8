"""True airspeed from the equivalent one."""

import pytest

from gcs_coloc.core.telemetry.reported_state import true_airspeed_mps


@pytest.mark.parametrize(
    ("alt_msl_m", "density_kg_m3"),
    [
        (-500.0, 1.2849),
        (0.0, 1.2250),
        (1000.0, 1.1116),
        (3000.0, 0.9091),
        (11_000.0, 0.36392),
        (15_000.0, 0.19367),
        (20_000.0, 0.08803),
    ],
)
def test_it_follows_the_density_that_the_standard_atmosphere_tabulates(alt_msl_m, density_kg_m3):
    assert true_airspeed_mps(25.0, alt_msl_m) == pytest.approx(25.0 * (1.2250 / density_kg_m3) ** 0.5, rel=1e-3)


def test_above_the_highest_layer_it_stays_finite():
    assert true_airspeed_mps(25.0, 100_000.0) == true_airspeed_mps(25.0, 20_000.0)
