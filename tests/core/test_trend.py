"""One polynomial through all nodes, against numpy."""

import math

import numpy as np
import pytest
from lattices import ask, complete, disc, exponents_of, field_of, monomials

from sphfilter.core.field.stencils import stencils
from sphfilter.core.field.trend import recentred, trend, value_at

#: Degree of the trend by dimension.
DEGREE = {3: 4, 4: 4, 5: 3, 6: 3}


def polynomial(n, degree, seed=0):
    """Coefficients (M,) up to a degree, all of which matter over a few cells; and their exponents."""
    E = exponents_of(stencils(n))
    c = np.random.default_rng(seed).normal(size=len(E)) / 4.0 ** E.sum(axis=1)
    return np.where(E.sum(axis=1) <= degree, c, 0.0), E


def values(nodes, c, E):
    """The polynomial with a constant of 2 at points (N, n)."""
    return np.array([monomials(d, E) @ c for d in nodes]) + 2.0


@pytest.mark.parametrize("n", range(1, 7))
def test_value_and_monomials_are_numpys(n):
    c, E = polynomial(n, 9)
    x, b = np.random.default_rng(n).normal(size=n), np.empty(len(E))
    assert value_at(x, stencils(n), c, b) == pytest.approx(monomials(x, E) @ c)
    assert np.allclose(b, monomials(x, E))


@pytest.mark.parametrize("n", range(1, 7))
def test_recentred_is_the_same_polynomial_around_another_centre(n):
    """f(x + d) - f(x), for all d."""
    c, E = polynomial(n, 9)
    rng = np.random.default_rng(n)
    x, out = rng.normal(size=n), np.empty(len(E))
    recentred(c, x, stencils(n), np.empty(len(E)), out)
    for d in rng.normal(size=(20, n)):
        assert monomials(d, E) @ out == pytest.approx((monomials(x + d, E) - monomials(x, E)) @ c, abs=1e-12)


@pytest.mark.parametrize(("n", "radius"), [(3, 3.2), (4, 2.9), (5, 2.5), (6, 2.3)])
def test_a_polynomial_of_its_degree_is_found_exactly(n, radius):
    """Quartics in three and four dimensions, cubics beyond."""
    c, E = polynomial(n, DEGREE[n])
    node = disc(n, radius)
    found = trend(node, values(node, c, E), stencils(n))
    assert np.allclose(found, c, atol=1e-8)


@pytest.mark.parametrize(("n", "radius"), [(3, 3.2), (4, 3.2)])
def test_a_field_of_a_quartic_is_exact_up_to_its_rim(n, radius):
    """Where nodes have no polynomial of their own, that of the nearest complete one has all terms too."""
    c, E = polynomial(n, 4)
    field = field_of(lambda d: values(d, c, E), n, radius)
    rim = np.setdiff1d(np.arange(len(field.node)), complete(field))
    assert len(rim) > 20
    d = field.node[rim].astype(float)
    assert np.allclose(ask(field, d), field.log_p[rim], atol=1e-7)
    d += np.random.default_rng(n).uniform(-0.3, 0.3, d.shape)
    assert np.allclose(ask(field, d), values(d, c, E), atol=1e-7)


@pytest.mark.parametrize("n", [3, 4])
def test_the_trend_is_numpys_weighted_least_squares(n):
    """Of anything else, weighted by the root of p."""
    node = disc(n, 3.0)
    log_p = -0.3 * (node**2).sum(axis=1) + np.sin(2.0 * node).sum(axis=1)
    E = exponents_of(stencils(n))
    basis = np.hstack([np.ones((len(node), 1)), [monomials(d, E) for d in node]])
    root = np.exp(0.25 * log_p)[:, None]
    expected = np.linalg.lstsq(root * basis, root[:, 0] * log_p, rcond=None)[0]
    assert np.allclose(trend(node, log_p, stencils(n)), expected[1:], atol=1e-6)


@pytest.mark.parametrize("n", [1, 2])
def test_no_trend_in_one_and_two_dimensions(n):
    node = disc(n, 6.0)
    assert len(stencils(n).trend) == 0
    assert trend(node, -0.1 * (node**2).sum(axis=1), stencils(n)).size == 0


def nodes_for(n, degree):
    """Fewest nodes for which a trend has this degree: five for two of its terms."""
    return math.ceil(2.5 * (math.comb(n + degree, n) - 1))


@pytest.mark.parametrize("n", DEGREE)
def test_no_trend_on_fewer_nodes_than_a_plane_needs(n):
    few = nodes_for(n, 1) - 1
    assert trend(disc(n, 3.2)[:few], np.zeros(few), stencils(n)).size == 0


@pytest.mark.parametrize(("n", "degree"), [(n, k) for n, most in DEGREE.items() for k in range(1, most + 1)])
def test_the_degree_is_the_highest_for_which_there_are_nodes_enough(n, degree):
    node, rng = disc(n, 3.2), np.random.default_rng(n)
    node = node[rng.permutation(len(node))]
    log_p, by_degree = rng.normal(size=len(node)), exponents_of(stencils(n)).sum(axis=1)
    most = len(node) if degree == DEGREE[n] else nodes_for(n, degree + 1) - 1
    for N in (nodes_for(n, degree), most):
        found = trend(node[:N], log_p[:N], stencils(n))
        assert found[by_degree == degree].all()
        assert not found[by_degree > degree].any()
