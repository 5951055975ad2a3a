"""Pieces of a density that are far from the rest and far lower: a prediction keeps what a reading may find."""

import numpy as np
import pytest
from scipy.stats import norm

import sphfilter as sf

RIGHT = np.array([9.0, 0.0])
#: A walk of x, and v that comes to rest: each piece of a mixture of Gaussians stays one.
WALK = sf.SDE.from_expressions(["x", "v"], ["0.0", "-v"], [["0.3"], ["0"]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.5]])


def pieces(weight, spread=2.0):
    """A standard normal, and a wide piece far to its right."""

    def pdf(X):
        near = norm.pdf(X).prod(axis=1)
        return (1.0 - weight) * near + weight * norm.pdf(X, RIGHT, spread).prod(axis=1)

    return pdf


@pytest.mark.parametrize("weight", [1e-2, 1e-3, 3e-4])
def test_a_low_wide_piece_is_carried(weight):
    density = sf.initialize(pieces(weight), 600, box=[[-6.0, 20.0], [-9.0, 9.0]])
    moved, info = sf.predict(density, WALK, 0.5)
    exact = weight * norm.sf(5.0, 9.0, np.sqrt(4.0 + 0.045))
    assert moved.probability(lambda X: X[:, 0] > 5.0) == pytest.approx(exact, rel=0.1)
    assert info.status == "ok" and info.mass_left_out < 1e-3


def test_a_reading_finds_it():
    """A reading beside the piece of a thousandth makes it nearly all."""
    density = sf.initialize(pieces(1e-3), 600, box=[[-6.0, 20.0], [-9.0, 9.0]])
    moved, _ = sf.predict(density, WALK, 0.5)
    posterior, info = sf.update(moved, POSITION, [8.0])
    variance, gain = 4.045, 4.045 / 4.545
    assert posterior.mean()[0] == pytest.approx(9.0 - gain * 1.0, abs=0.02)
    assert posterior.cov()[0, 0] == pytest.approx(variance * (1.0 - gain), rel=0.03)
    assert info.log_evidence == pytest.approx(np.log(1e-3) + norm.logpdf(8.0, 9.0, np.sqrt(4.545)), abs=0.05)
