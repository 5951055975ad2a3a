"""Closing in on posteriors that lie in one layer of the prior's lattice."""

import numpy as np
import pytest

import sphfilter as sf


@pytest.mark.parametrize("noise", [0.03, 0.02])
def test_one_of_four_states_is_read_sharply(noise):
    """Nodes of a single layer are many in four states, and know nothing of how wide the posterior is."""
    prior = sf.initialize(sf.Gaussian(np.zeros(4), np.eye(4)), 800)
    sensor = sf.GaussianMeasurement(np.eye(1, 4), [[noise**2]])
    density, info = sf.update(prior, sensor, [0.72])
    assert info.scheme == "log_density" and info.status == "ok"
    assert density.mean() == pytest.approx([0.72 / (1.0 + noise**2), 0.0, 0.0, 0.0], abs=1e-3 * noise)
    variance = noise**2 / (1.0 + noise**2)
    assert np.diag(density.cov()) == pytest.approx([variance, 1.0, 1.0, 1.0], rel=1e-3)
