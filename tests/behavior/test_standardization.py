"""Standardized features equal numpy's to the last bit."""

import numpy as np
import pytest

from behavexplor.behavior.features import N_FEATURES, NEGLIGIBLE
from behavexplor.behavior.miner import standardize


@pytest.mark.parametrize("count", [1, 2, 7, 300, 20_000])
def test_features_are_standardized_as_by_numpy(count):
    rng = np.random.default_rng(count)
    sample = rng.normal(rng.normal(size=N_FEATURES), rng.random(N_FEATURES), (count, N_FEATURES)).astype(np.float32)
    sample[:, 3] = 0.1  # hardly varies
    rows, mean, scale = np.empty(sample.shape), np.zeros(N_FEATURES), np.zeros(N_FEATURES)
    standardize(sample, NEGLIGIBLE, mean, scale, rows)
    wide = sample.astype(np.float64)
    np.testing.assert_array_equal(mean, wide.mean(0))
    np.testing.assert_array_equal(scale, np.maximum(wide.std(0), NEGLIGIBLE))
    np.testing.assert_array_equal(rows, (wide - mean) / scale)
    assert scale[3] == NEGLIGIBLE[3]
