"""What lies far away is told, not lost: beyond a prior's pieces, and beside one family."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.as_family import as_polynomials, family_of
from sphfilter.density.family import OF_MISFIT

X = np.linspace(-16.0, 10.0, 20_001)


@pytest.mark.parametrize("z", [-30.0, -5.0, 12.0])
def test_a_flat_side_of_a_sensor_keeps_its_tail(z):
    """exp(0.7 x) says little of states below zero: there the posterior is as wide as the prior."""
    model = sf.LinearSDE([[-0.1]], noise=[[0.3]])
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["exp(0.7*x)"], [[40.0]])
    flt = sf.SPHFilter(model, sensor, [1.0], [[6.0]])
    flt.predict(0.1)
    mean, variance = flt.x[0], flt.P[0, 0]
    info = flt.update([z])
    log_p = -0.5 * (X - mean) ** 2 / variance - 0.5 * (z - np.exp(0.7 * X)) ** 2 / 40.0
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    exact = p @ X
    spread = p @ (X - exact) ** 2
    assert abs(flt.x[0] - exact) < 3.0 * max(info.error, 0.01) * np.sqrt(spread)
    assert flt.P[0, 0] == pytest.approx(spread, rel=0.03)


def test_a_family_does_not_stand_for_a_density_with_a_part_far_away():
    """Polynomials fit log p where most of it is; a thousandth far away is a third of the variance."""
    model = sf.SDE.from_expressions(["x"], ["-0.1*x"], [["0.1"]], [[1.0]])
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x**2"], [[0.02]])
    flt = sf.SPHFilter(
        model, sensor, [-1.2], [[0.36]], n_particles=300, config=sf.FilterConfig(scheme="log_density")
    )
    flt.predict(0.1)
    flt.update([1.44])
    far = flt.density.mass[flt.density.x[:, 0] > 0.0].sum()
    assert 1e-4 < far < 1e-2
    assert as_polynomials(flt.density, 4, 0.01) is None
    assert OF_MISFIT * family_of(flt.density, 4)[1] > 0.01
