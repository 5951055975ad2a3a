"""What a family leaves out: a polynomial with its sign, errors that have none, and what both tell."""

import numpy as np
import pytest
from scipy.linalg import expm

import sphfilter as sf
from sphfilter.density.defect import Defect, read_out
from sphfilter.density.family import Family, fitted, gaussian_family

WELL = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
VAN_DER_POL = sf.SDE.from_expressions(["x", "v"], ["v", "(1 - x**2)*v - x"], [["0"], ["1"]], [[0.3]])


def predicted(model, degree, t, P, tolerance=1e-3):
    start = sf.initialize(sf.Gaussian(np.ones(model.dim), P * np.eye(model.dim)), "auto")
    scheme = sf.FamilyScheme(degree=degree, tolerance=tolerance)
    return sf.predict(start, model, t, sf.SolverConfig(scheme=scheme))[0]


def shift(density):
    """By how much the defect moves the mean, to first order."""
    heavy = density.mass * density.defect.at(density.family, density.x)
    return heavy @ density.x - heavy.sum() * density.mean()


@pytest.mark.parametrize("model", [WELL, VAN_DER_POL])
def test_a_defect_of_a_gaussian_is_what_higher_degrees_see(model):
    low, high = predicted(model, 2, 0.1, 0.1), predicted(model, 6, 0.1, 0.1)
    missed, defect = high.logpdf(high.x) - low.logpdf(high.x), low.defect.at(low.family, high.x)
    apart = np.cov([missed, defect], aweights=high.mass)
    assert apart[0, 1] / np.sqrt(apart[0, 0] * apart[1, 1]) > 0.9
    assert apart[1, 1] / apart[0, 0] == pytest.approx(1.0, abs=0.5)


def test_the_shift_of_a_cubic_has_its_sign_and_size():
    low, high = predicted(WELL, 3, 0.1, 0.1), predicted(WELL, 6, 0.1, 0.1)
    missed = (high.mean() - low.mean())[0]
    assert missed > 0.003 and shift(low)[0] == pytest.approx(missed, rel=0.2)
    assert 1.0 < low.error * high.cov()[0, 0] ** 0.5 / missed < 3.0


def test_long_steps_are_as_good_as_short_ones():
    """Heun's steps grew by themselves where those of the family are long for polynomials of degree eight."""
    rough, fine = (predicted(WELL, 6, 0.4, 0.1, tolerance) for tolerance in (1e-3, 1e-6))
    assert np.abs(rough.defect.e - fine.defect.e).max() < 0.01
    assert rough.error < 2.0 * fine.error < 0.01


@pytest.mark.parametrize("n, degree", [(1, 4), (1, 6), (3, 4)])
@pytest.mark.parametrize("steep", [1, 3, 6, 10])
def test_a_bend_between_the_nodes_is_told(steep, n, degree):
    """The steeper, the less of it the family's own nodes see: they told a thirtieth of what it makes."""
    drift, noise = [f"-0.4*tanh({steep}*x)", "-0.5*v", "-0.3*u"][:n], [["0"], ["1"], ["0"]][:n]
    model = sf.SDE.from_expressions(["x", "v", "u"][:n], drift, noise, [[0.3]])
    start = sf.initialize(sf.Gaussian(np.eye(n)[0] * 0.4, np.eye(n) * 0.64), "auto")
    found, info = sf.predict(start, model, 0.3, sf.SolverConfig(scheme=sf.FamilyScheme(degree=degree)))
    x = np.linspace(-6.0, 6.8, 4001)
    w = np.exp(-0.5 * (x - 0.4) ** 2 / 0.64) / np.exp(-0.5 * (x - 0.4) ** 2 / 0.64).sum()
    moved = np.arcsinh(np.sinh(steep * x) * np.exp(-0.4 * steep * 0.3)) / steep  # no noise moves it
    mean, variance = w @ moved, w @ (moved - w @ moved) ** 2
    shift = abs(found.mean()[0] - mean) / np.sqrt(n * variance)
    made = max(shift, abs(found.cov()[0, 0] / variance - 1.0) / (2.0 * n))
    assert made / 1.3 < info.error < max(4.0 * made, 0.002)  # of so little nobody asks by how much


def test_no_error_hangs_on_units():
    found = []
    for unit in (1.0, 1e3):
        model = sf.SDE.from_expressions(["x"], [f"x - x**3/{unit**2}"], [[f"{unit}"]], [[0.5]])
        sensor = sf.GaussianMeasurement([[1.0]], [[0.2 * unit**2]])
        config = sf.FilterConfig(scheme=sf.FamilyScheme(degree=4))
        flt = sf.SPHFilter(model, sensor, [unit], [[0.1 * unit**2]], config=config)
        said = [(flt.predict(0.2).error, flt.update([z * unit])) for z in (1.5, 0.2)]
        found.append([(before, info.error, info.evidence_error) for before, info in said])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


def test_a_reading_shows_what_was_wrong_with_a_tail():
    """Degree three is right within a hundredth where it is, and wrong by a tenth where a reading leads."""
    sensor, exact = sf.GaussianMeasurement([[1.0]], [[0.05]]), predicted(WELL, 6, 0.1, 0.1)
    start = predicted(WELL, 3, 0.1, 0.1)
    for z in (0.2, 2.2):
        config = sf.FilterConfig(scheme=sf.FamilyScheme(degree=3))
        new, info = sf.update(start, sensor, [z], config)
        true, other = sf.update(exact, sensor, [z], sf.FilterConfig(scheme="log_density"))
        off = abs(new.mean() - true.mean())[0] / true.cov()[0, 0] ** 0.5
        assert off > 0.05 and off / 3.0 < info.error < 3.0 * off
        assert abs(info.log_evidence - other.log_evidence) < 2.0 * info.evidence_error


def test_a_polynomial_that_rises_far_out_is_told():
    family = fitted(lambda X: -0.5 * X[:, 0] ** 2 + 0.05 * X[:, 0] ** 3, np.zeros(1), np.eye(1), 3)[0]
    assert read_out(family, Defect.none(family)).error > 0.01
    gaussian = gaussian_family(np.zeros(1), np.eye(1), 3)
    assert read_out(gaussian, Defect.none(gaussian)).error == pytest.approx(1e-5)
    assert read_out(gaussian, Defect.none(gaussian, 0.02)).error == pytest.approx(0.02, rel=0.01)


def test_errors_without_a_sign_go_with_the_flow():
    """Steps of U + h dU led to variances below zero, and `told_at` to the root of one."""
    F = np.array([[-1.0, 6.0], [-6.0, -8.0]])
    model = sf.LinearSDE(F, noise=[[0.1], [0.1]])
    start = sf.initialize(sf.Gaussian(np.zeros(2), np.eye(2)), "auto")
    along = np.array([[1.0, 0.2]])  # all of the error lies on a line
    known = Defect(Defect.none(start.family).e, along.T @ along, 0.0)
    scheme = sf.FamilyScheme(degree=2, tolerance=0.1)
    moved, _ = sf.predict(
        start.noted(defect=known), model, 0.4, sf.SolverConfig(scheme=scheme, exact_linear=False)
    )
    end = expm(0.4 * F) @ along.T
    assert np.linalg.eigvalsh(moved.defect.U)[0] > -1e-9
    np.testing.assert_allclose(moved.defect.U, end @ end.T, atol=1e-3)


def test_what_holds_no_density_is_refused():
    family = Family(np.zeros(1), np.eye(1), np.array([0.0, 0.0, -1e6]))
    with pytest.raises(sf.PropagationError, match="few of its nodes"):
        read_out(family, Defect.none(family))
