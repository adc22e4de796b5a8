"""The adjustment's parts against textbook forms."""

import numpy as np
import pytest

from gcs_coloc.core.adjustment import pinv


@pytest.mark.parametrize("scale", [0.1, 1.0, 1e4])
def test_the_pseudo_inverse_is_that_of_the_singular_values(scale):
    rng = np.random.default_rng(3)
    for _ in range(200):
        root = rng.standard_normal((2, 2)) * scale
        A = root @ root.T
        if np.linalg.cond(A) < 1e5:
            inverse, rank = pinv(A)
            assert rank == 2
            np.testing.assert_allclose(inverse, np.linalg.pinv(A), rtol=1e-6)
        one = np.outer(root[0], root[0])
        inverse, rank = pinv(one)
        assert rank == 1
        np.testing.assert_allclose(inverse, np.linalg.pinv(one, rcond=1e-6), rtol=1e-6, atol=1e-12 / scale**2)


def test_what_nothing_measures_has_no_inverse():
    inverse, rank = pinv(np.zeros((2, 2)))
    assert rank == 0
    assert not inverse.any()
