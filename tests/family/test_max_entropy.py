"""Families with the moments of points: of points that came from one, and of points that no family holds."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.as_family import as_polynomials, max_entropy

SCHEME = sf.FilterConfig(scheme=sf.FamilyScheme(degree=4))
BENT = sf.SDE.from_expressions(["x", "v"], ["v", "-x - 0.1*x**3 - 0.4*v"], [["0"], ["0.8"]])
START = sf.initialize(sf.Gaussian([1.0, 0.0], [[0.3, 0.05], [0.05, 0.4]]), 200)


@pytest.fixture(scope="module")
def bent():
    """A density that is a family of degree four, and no Gaussian."""
    return sf.predict(START, BENT, 1.0, SCHEME)[0]


def test_points_of_a_family_give_it_back(bent):
    x, mass = bent.form.drawn(20_000, 7)
    found, misfit = max_entropy(x, mass, 4)
    near = bent.sample(200, 3)
    np.testing.assert_allclose(found.log_p(near), bent.logpdf(near), atol=0.15)
    assert misfit < 0.05
    np.testing.assert_allclose(mass @ x, bent.mean(), atol=1e-12)


def test_a_lower_degree_misses_more(bent):
    x, mass = bent.form.drawn(20_000, 7)
    misfits = [max_entropy(x, mass, degree)[1] for degree in (2, 3, 4)]
    assert misfits[0] > 2.0 * misfits[1] > 4.0 * misfits[2]


def cloud_of(x):
    x = np.asarray(x)
    return sf.ParticleDensity(
        x=x, mass=np.full(len(x), 1.0 / len(x)), h=np.full(len(x), 0.1), read_out="cloud"
    )


def test_a_ring_is_no_family():
    rng = np.random.default_rng(2)
    angle, radius = rng.uniform(0, 2 * np.pi, 6000), rng.normal(5.0, 0.1, 6000)
    ring = cloud_of(np.transpose([radius * np.cos(angle), radius * np.sin(angle)]))
    assert as_polynomials(ring, 4, 0.05) is None


def test_points_on_a_line_are_no_family():
    flat = np.random.default_rng(2).normal(size=(500, 1)) @ np.ones((1, 2))
    assert as_polynomials(cloud_of(flat), 4, 0.05) is None


def test_normal_points_are_one_and_keep_their_moments():
    x = np.random.default_rng(1).normal(size=(4000, 3)) @ np.diag([1.0, 2.0, 0.1])
    one = as_polynomials(cloud_of(x), 4, 0.05)
    assert one is not None and one.read_out == "family"
    np.testing.assert_allclose(one.mean(), x.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(one.cov(), np.cov(x.T, bias=True), rtol=1e-5, atol=1e-6)
