from __future__ import annotations

import numpy as np

from gcs_coloc.planning.predicted_flight import PredictedStep, as_prediction


def test_where_an_estimate_without_noise_leaves_its_bound_and_a_while_after_nothing_is_told():
    offsets_m = [0.0, 0.0, 145.0, *[0.0] * 10]
    rows = [
        PredictedStep(2.0 * k, (0.0, 0.0, 100.0), 1.2, 21.0, 30.0, offset_m, 4, True, "", "")
        for k, offset_m in enumerate(offsets_m)
    ]
    told = as_prediction(1, (1,), rows).is_told
    at_s = 2.0 * np.arange(len(rows))
    np.testing.assert_array_equal(told, (at_s < 4.0) | (at_s > 4.0 + 15.0))
