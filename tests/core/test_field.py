"""Polynomials of log p on a lattice, against numpy and scipy.ndimage."""

import math

import numpy as np
import pytest
from lattices import ask, complete, disc, exponents_of, field_of, lower, monomials
from scipy import ndimage

from sphfilter.core.field.cells import LOWEST, UNKNOWN, frontier, opened
from sphfilter.core.field.field import evaluate
from sphfilter.core.field.fitting import build_field
from sphfilter.core.field.stencils import stencils
from sphfilter.core.small_matrices import eigen, invert_lower

#: By dimension, the degree of each neighbourhood's polynomial and whether it has terms x_a x_b x_c.
LEVELS = {
    1: [(2, True), (4, True), (6, True)],
    2: [(2, True), (3, True), (3, True), (4, True)],
    3: [(2, True), (3, False), (3, True)],
    4: [(2, True), (3, False)],
    5: [(2, True), (3, False)],
    6: [(2, True), (3, False)],
}
#: Highest degree of any polynomial, local or through all nodes.
HIGHEST = {1: 6, 2: 4, 3: 4, 4: 4, 5: 3, 6: 3}


@pytest.mark.parametrize("n", LEVELS)
def test_stencils_reproduce_the_polynomials_of_their_degree(n):
    sten = stencils(n)
    E = exponents_of(sten)
    assert len({tuple(e) for e in E}) == len(E) == math.comb(n + HIGHEST[n], n) - 1
    assert E.sum(axis=1).max() == HIGHEST[n]
    assert len(sten.size) == len(LEVELS[n])
    rng = np.random.default_rng(n)
    for level, (degree, mixed) in enumerate(LEVELS[n]):
        used = E.sum(axis=1) <= degree
        if not mixed:
            used &= ~((E.sum(axis=1) == 3) & ((E > 0).sum(axis=1) == 3))
        c = np.where(used, rng.normal(size=len(E)), 0.0)
        offsets = sten.offsets[: sten.size[level]]
        differences = np.array([monomials(o, E) @ c for o in offsets])
        assert np.allclose(differences @ sten.rows[level, : sten.size[level]], c, atol=1e-10)
        assert not sten.rows[level, sten.size[level] :].any()
        assert not sten.rows[level][:, ~used].any()  # terms that only the trend has


@pytest.mark.parametrize("n", LEVELS)
def test_neighbourhoods_are_nested_and_symmetric(n):
    sten = stencils(n)
    assert np.all(np.diff(sten.size) > 0)
    assert sten.size[-1] == len(sten.offsets)
    for size in sten.size:
        found = {tuple(o) for o in sten.offsets[:size]}
        assert len(found) == size
        assert found == {tuple(-k for k in o) for o in found}
        assert (0,) * n not in found


WIDE = [(5, 2.5), (6, 2.3)]


@pytest.mark.parametrize(("n", "radius"), [(1, 6), (2, 4.5), (3, 3.2), (4, 2.9), *WIDE])
def test_a_gaussian_is_exact_on_its_lattice_and_nearly_in_its_tail(n, radius):
    """Nodes out to four deviations along the widest axis; its tail has the covariance of the nodes."""
    rng = np.random.default_rng(n)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    H = turn * np.linspace(1.0, 1.4, n) @ turn.T * (4.0 / radius) ** 2

    def log_p(d):
        return 0.7 - 0.5 * np.einsum("ia,ab,ib->i", d, H, d)

    field = field_of(log_p, n, radius)
    inside = rng.uniform(-0.5, 0.5, (40, n)) + field.node[rng.choice(complete(field), size=40)]
    assert np.allclose(ask(field, inside), log_p(inside), atol=1e-9)
    outside = 3.0 * radius * rng.normal(size=(40, n))
    assert np.allclose(ask(field, outside), log_p(outside), rtol=0.05, atol=1e-9)


def test_a_tail_unlike_the_nodes_covariance_is_its_own():
    """Two narrow peaks far from each other: away from both, each falls by its own curvature."""
    ball, offset = disc(2, 4.0), np.array([8, 0])
    node = np.concatenate([ball - offset, ball + offset])

    def log_p(d):
        return -0.7 * np.minimum(((d - offset) ** 2).sum(axis=1), ((d + offset) ** 2).sum(axis=1))

    field = build_field(np.zeros(2), np.eye(2), node, len(node), log_p(node.astype(float)), stencils(2))
    far = np.array([[8.0, 30.0], [-8.0, -25.0], [20.0, 0.5]])
    assert np.allclose(ask(field, far), log_p(far), rtol=1e-9)


@pytest.mark.parametrize(("n", "radius", "degree"), [(1, 8, 6), (2, 6.0, 4), (3, 4.5, 4), (4, 3.5, 4)])
def test_polynomials_are_exact_in_the_middle(n, radius, degree):
    """Of the widest neighbourhood's degree, and from three dimensions on of the trend's."""
    E = exponents_of(stencils(n))
    rng = np.random.default_rng(n)
    c = rng.normal(size=len(E)) * (E.sum(axis=1) <= degree) / 10.0 ** E.sum(axis=1)

    def polynomial(d):
        return np.array([monomials(row, E) @ c for row in d]) + 2.0

    field = field_of(polynomial, n, radius)
    d = rng.uniform(-1.4, 1.4, (50, n))
    assert np.allclose(ask(field, d), polynomial(d), atol=1e-9)


@pytest.mark.parametrize(("n", "radius"), [(1, 7), (2, 5.0), (3, 3.5), (4, 3.0)])
def test_evaluate_against_numpy(n, radius):
    """A bumpy function: the polynomial of the cell's owner near it, its concave quadratic part far away."""
    sten, rng = stencils(n), np.random.default_rng(n)
    E = exponents_of(sten)
    field = field_of(lambda d: -0.3 * (d**2).sum(axis=1) + np.sin(d).sum(axis=1), n, radius)
    d = np.concatenate([rng.uniform(-scale * radius, scale * radius, (100, n)) for scale in (1, 3)])
    expected = []
    for y in d:
        cell = np.clip(np.floor(y + 0.5).astype(int) - field.low, 0, field.dims - 1)
        j, most = field.owner[np.ravel_multi_index(tuple(cell), tuple(field.dims))], np.inf
        if j < 0:
            j, most = ~j, field.cap
        r = y - field.node[j]
        linear = field.coefficient[j, :n] @ r
        far = min(linear + 0.5 * r @ field.tail[j] @ r, 0.0)
        value = monomials(r, E) @ field.coefficient[j] if r @ r <= 4.5 else far
        expected.append(min(field.log_p[j] + value, most))
    assert np.allclose(ask(field, d), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("n", "radius"), [(1, 6), (2, 4.5), (3, 3.2)])
def test_tails_are_concave_and_never_rise(n, radius):
    rng = np.random.default_rng(n)
    noisy = rng.normal(size=len(disc(n, radius)))
    field = field_of(lambda d: noisy, n, radius)
    with_own = complete(field)
    second = np.zeros((len(field.node), n, n))
    for k, e in enumerate(exponents_of(stencils(n))):
        if e.sum() == 2:
            a, b = np.repeat(np.arange(n), e)
            second[:, a, b] = second[:, b, a] = field.coefficient[:, k] * (2 if a == b else 1)
    for i in with_own:
        w, V = np.linalg.eigh(second[i])
        bent = np.linalg.eigvalsh(field.tail[i])
        assert bent.max() < 1e-12
        own = V * np.minimum(w, bent.max()) @ V.T  # what rises is bent down, the rest is as fitted
        shared = np.linalg.norm(second[i] - field.tail[i]) < 0.2 * np.linalg.norm(field.tail[i])
        assert shared or np.allclose(field.tail[i], own, atol=1e-9)
    far = rng.normal(size=(300, n))
    far *= (radius + 3.0 + 100.0 * rng.random((300, 1))) / np.linalg.norm(far, axis=1, keepdims=True)
    assert np.all(ask(field, far) <= field.log_p[with_own].max())


def test_states_beyond_all_numbers_have_the_lowest_density():
    field = field_of(lambda d: -0.5 * (d**2).sum(axis=1), 2, 4.5)
    out = np.empty(4)
    Y = np.array([[1e200, 0.0], [np.nan, 0.0], [np.inf, -np.inf], [1e140, 0.0]])
    evaluate(field, stencils(2), Y, out)
    assert np.all(out[:3] == LOWEST)
    assert LOWEST < out[3] < -1e270


@pytest.mark.parametrize("n", [1, 2, 3])
def test_every_cell_is_owned_by_a_complete_node_nearby(n):
    """Two pieces: the nearest complete node, or one less than a cell further away.

    Cells where no node lies are told from the others by the complement of their owner.
    """
    ball = disc(n, 3.0)
    node = np.concatenate([ball, ball + np.array([9] + [1] * (n - 1))])
    sten = stencils(n)
    field = build_field(np.zeros(n), np.eye(n), node, len(node), np.zeros(len(node)), sten)
    nodes = {tuple(row) for row in node}
    first = sten.offsets[: sten.size[0]]
    own = [i for i, row in enumerate(node) if all(tuple(row + o) in nodes for o in first)]
    assert sorted(own) == complete(field).tolist()
    cells = np.array(list(np.ndindex(*field.dims))) + field.low
    distance = np.linalg.norm(cells[:, None] - node[own], axis=2).min(axis=1)
    lies = np.array([tuple(cell) in nodes for cell in cells])
    assert np.array_equal(field.owner >= 0, lies)
    chosen = np.linalg.norm(cells - node[np.where(lies, field.owner, ~field.owner)], axis=1)
    assert np.all(chosen <= distance + 1.0)
    assert np.mean(chosen > distance + 1e-9) < 0.02


def blobs(n, rng, empty):
    value = ndimage.gaussian_filter(rng.normal(size=(14,) * n), 1.0)
    value[rng.random(value.shape) < 0.1] = empty
    return value


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_opened_is_a_morphological_opening(n, seed):
    value = blobs(n, np.random.default_rng(seed), -10.0)
    ball = stencils(n).offsets[: stencils(n).size[0]]
    element = np.zeros((3,) * n, bool)
    element[tuple((ball + 1).T)] = element[(1,) * n] = True
    level = np.median(value) - 0.3 * value.std()
    asked = np.flatnonzero(value > -10.0)
    found = opened(value.ravel(), asked, level, np.array(value.shape), ball)
    expected = ndimage.binary_opening(value > level, element)
    assert np.array_equal(found, np.flatnonzero(expected))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_frontier_is_the_unknown_rim_of_a_dilation(n, seed):
    value = blobs(n, np.random.default_rng(10 + seed), UNKNOWN)
    ball = stencils(n).offsets[: stencils(n).size[0]]
    element = np.zeros((3,) * n, bool)
    element[tuple((ball + 1).T)] = element[(1,) * n] = True
    inner = ndimage.binary_erosion(np.ones(value.shape, bool))
    for level, region in ((np.median(value[value > UNKNOWN]), value), (0.0, np.where(inner, value, UNKNOWN))):
        given, asked = region.ravel().copy(), np.flatnonzero(region > UNKNOWN)
        found, beyond = frontier(given, asked, level, np.array(value.shape), ball)
        expected = ndimage.binary_dilation(region > level, element) & (region == UNKNOWN)
        assert np.array_equal(np.sort(found), np.flatnonzero(expected))
        assert beyond == np.any(region[~inner] > level)
        given[found] = UNKNOWN  # what was found is marked, and nothing else touched
        assert np.array_equal(given, region.ravel())


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_small_linear_algebra(n):
    rng = np.random.default_rng(n)
    h = rng.normal(size=(n, n))
    h = h + h.T
    w, V = np.empty(n), np.empty((n, n))
    eigen(h.copy(), w, V)
    assert np.allclose(np.sort(w), np.linalg.eigvalsh(h))
    assert np.allclose(V * w @ V.T, h)
    assert np.allclose(V.T @ V, np.eye(n))
    A = lower(n)
    assert np.allclose(invert_lower(A), np.linalg.inv(A))
