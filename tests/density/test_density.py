"""`ParticleDensity`: every question it answers, against closed forms of a Gaussian cloud."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats

import sphfilter as sf

MEAN, COV = np.array([1.0, -2.0]), np.array([[2.0, 0.6], [0.6, 1.0]])


@pytest.fixture(scope="module")
def density():
    config = sf.SolverConfig.paper(kernel="gaussian", represented_mass=0.9999)
    return sf.initialize(sf.Gaussian(MEAN, COV), 4000, config)


def test_pdf_integrates_to_one_in_one_dimension():
    p = sf.initialize(sf.Gaussian([0.5], [[4.0]]), 60)
    y = np.linspace(-15, 15, 20_001)
    assert integrate.trapezoid(p.pdf(y[:, None]), y) == pytest.approx(1.0, rel=1e-6)


def test_pdf_is_near_the_gaussian(density):
    X = stats.multivariate_normal(MEAN, COV).rvs(200, random_state=0)
    exact = stats.multivariate_normal(MEAN, COV).pdf(X)
    assert density.pdf(X) == pytest.approx(exact, abs=0.01 * exact.max())
    assert density.logpdf(X[0]) == pytest.approx(np.log(density.pdf(X[0])))


def test_logpdf_far_outside_is_minus_infinity(density):
    assert density.logpdf([1e6, 0.0])[0] == -np.inf


def test_moments(density):
    assert density.mean() == pytest.approx(MEAN, abs=1e-6)
    assert density.cov() == pytest.approx(COV, rel=5e-3)
    mixture = density.cov("mixture")
    own = density.kernel_variance * density.mass @ density.h**2
    assert mixture == pytest.approx(density.cov() + own * np.eye(2))
    assert density.moment([1, 0]) == pytest.approx(MEAN[0], abs=1e-6)
    assert density.moment([1, 1], central=True) == pytest.approx(density.cov()[0, 1])
    assert density.moment([2, 0], central=True, kind="mixture") == pytest.approx(mixture[0, 0], rel=5e-3)


def test_probability_and_marginal(density):
    exact = stats.norm.sf(3.0, MEAN[0], np.sqrt(COV[0, 0]))
    assert density.probability(lambda X: X[:, 0] > 3.0) == pytest.approx(exact, rel=0.05)
    one = density.marginal([1])
    y = np.linspace(-5, 1, 13)[:, None]
    assert one.dim == 1
    assert one.pdf(y) == pytest.approx(stats.norm.pdf(y[:, 0], MEAN[1], np.sqrt(COV[1, 1])), abs=0.01)
    np.testing.assert_array_equal(density.marginal(1).x, one.x)
    assert density.marginal([1, 0]).mean() == pytest.approx(MEAN[::-1], abs=1e-6)


def test_mode_and_hpd_level(density):
    assert density.mode() == pytest.approx(MEAN, abs=0.1)
    peak = 1 / (2 * np.pi * np.sqrt(np.linalg.det(COV)))
    assert density.hpd_level(0.5) == pytest.approx(
        0.5 * peak, rel=0.03
    )  # chi-square of two: exp(-r²/2) = 1 - P


def test_samples_follow_the_mixture(density):
    X = density.sample(20_000, rng=3)
    np.testing.assert_array_equal(X, density.sample(20_000, rng=3))
    assert X.mean(axis=0) == pytest.approx(density.mean(), abs=0.05)
    assert np.cov(X.T) == pytest.approx(density.cov("mixture"), abs=0.08)


def test_arrays_are_read_only_and_own(density):
    with pytest.raises(ValueError, match="read-only"):
        density.x[0] = 0.0
    x = np.zeros((3, 1))
    p = sf.ParticleDensity(x=x, mass=np.ones(3), h=np.ones(3))
    x[:] = 7.0
    assert p.x.max() == 0.0
    assert p.mass.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((3, 1)), "h": np.ones(2)}, "shape"),
        ({"x": np.full((3, 1), np.nan)}, "NaN"),
        ({"mass": -np.ones(3)}, "masses >= 0"),
        ({"mass": np.zeros(3)}, "masses >= 0"),
        ({"h": np.zeros(3)}, "h > 0"),
        ({"kernel": "gausian"}, "gaussian"),
        ({"read_out": "dots"}, "points"),
    ],
)
def test_bad_densities(change, message):
    good = {"x": np.zeros((3, 1)), "mass": np.ones(3), "h": np.ones(3)}
    with pytest.raises(sf.ModelError, match=message):
        sf.ParticleDensity(**{**good, **change})


def test_changed_copies_answer_for_themselves(density):
    density.pdf(MEAN)
    moved = replace(density, x=density.x + 10.0)
    assert moved.pdf(MEAN + 10.0) == pytest.approx(density.pdf(MEAN))
    again = pickle.loads(pickle.dumps(density))
    assert not again.x.flags.writeable
    assert again.pdf(MEAN) == pytest.approx(density.pdf(MEAN), rel=1e-12)
    assert not copy.deepcopy(density).mass.flags.writeable


def test_particles_without_mass_are_left_out():
    p = sf.ParticleDensity(x=[[0.0], [9.0], [1.0]], mass=[1.0, 0.0, 1.0], h=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(p.x, [[0.0], [1.0]])
    np.testing.assert_array_equal(p.h, [1.0, 3.0])


def test_bad_questions(density):
    for question, message in [
        (lambda: density.pdf(np.zeros((4, 3))), "shape"),
        (lambda: density.moment([1]), "powers"),
        (lambda: density.moment([1, -1]), "powers"),
        (lambda: density.marginal([0, 0]), "axes"),
        (lambda: density.marginal([2]), "axes"),
        (
            lambda: density.probability(lambda X: X > 0.0),
            "what the region returns has shape .* each row of X",
        ),
        (lambda: density.hpd_level(1.0), "between 0 and 1"),
        (lambda: density.cov("pints"), "points"),
    ]:
        with pytest.raises(sf.ModelError, match=message):
            question()


@pytest.mark.parametrize("domain", [None, [("periodic", -np.pi, np.pi), None]])
def test_a_density_tells_itself_in_a_line(domain):
    p = sf.initialize(sf.Gaussian([0.5, -1.0], np.diag([0.04, 0.25])), 100, t=2.0, domain=domain)
    said = repr(p)
    for text in (f"N={p.n_particles}, dim=2, t=2, read_out='log_density'", "mean=[0.5, -1]", "std=[0."):
        assert text in said
    assert ("periodic" in said) is (domain is not None)
    assert len(said) < 250


def test_a_density_is_no_array_and_its_tails_have_logarithms_within_walls():
    density = sf.initialize(sf.Gaussian([0.0], [[0.05]]), 60)
    assert np.shape(density) == ()
    model = sf.SDE.from_expressions(["x"], ["-x"], [["1"]], domain=[("bounded", -10.0, 10.0)])
    walled, _ = sf.predict(density, model, 0.0)
    assert walled.logpdf([[9.0]]) == pytest.approx(density.logpdf([[9.0]]))
    assert walled.logpdf([[11.0]]) == -np.inf
    assert walled.pdf([[11.0]]) == 0.0
