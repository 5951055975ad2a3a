"""What the noise paths are aimed with, and what keeps a fit's ripples from outside of the nodes."""

import numpy as np
import pytest
from lattices import ask, disc, field_of

from sphfilter.core.field.field import slopes
from sphfilter.core.field.stencils import stencils

SIZES = [(1, 7), (2, 5.0), (3, 3.5), (4, 3.0)]


def slopes_at(field, d):
    """Slopes (M, n) at lattice coordinates d (M, n), and whose polynomial's they are (M,)."""
    Y = np.ascontiguousarray(field.mu + d @ field.A.T)
    owner, out = np.empty(len(d), np.int64), np.empty_like(Y)
    slopes(field, stencils(d.shape[1]), Y, owner, out)
    return out, owner


def owners(field, d):
    """Whose polynomial it is (M,), and whether a node lies in that cell."""
    cells = np.clip(np.floor(d + 0.5).astype(int) - field.low, 0, field.dims - 1)
    found = field.owner[np.ravel_multi_index(tuple(cells.T), tuple(field.dims))]
    return np.where(found >= 0, found, ~found), found >= 0


def bumpy(d):
    return -0.4 * (d**2).sum(axis=1) + 0.5 * np.sin(d).sum(axis=1)


def lopsided(d):
    """Quadratic, its axes not those of the lattice."""
    return -0.4 * (d**2).sum(axis=1) + 0.3 * d[:, 0] * d[:, -1] - 0.7 * d[:, 0]


@pytest.mark.parametrize(("n", "radius"), SIZES)
@pytest.mark.parametrize(("log_p", "nearest"), [(lopsided, -1.0), (bumpy, 4.5)])
def test_slopes_are_central_differences_of_the_values(log_p, nearest, n, radius):
    """Of a quadratic everywhere, of anything else beyond the rim; away from borders between polynomials."""
    field, step = field_of(log_p, n, radius), 1e-5
    rng = np.random.default_rng(n)
    d = np.concatenate([rng.uniform(-scale * radius, scale * radius, (300, n)) for scale in (0.5, 1.0, 3.0)])
    d = d[np.abs(d - np.floor(d + 0.5)).max(axis=1) < 0.49]
    owner, lies = owners(field, d)
    r2 = ((d - field.node[owner]) ** 2).sum(axis=1)
    value = ask(field, d)
    cut = (~lies & (value >= field.cap - 1e-3)) | ((r2 > 4.5) & (value >= field.log_p[owner] - 1e-3))
    counts = ~cut & (np.abs(r2 - 4.5) > 1e-2) & (r2 > nearest)
    found, whose = slopes_at(field, d)
    assert np.array_equal(whose, owner)
    assert counts[r2 > 4.5].sum() > 50
    assert nearest > 0.0 or counts[r2 <= 4.5].sum() > 50
    differences = [(ask(field, d + step * e) - ask(field, d - step * e)) / (2.0 * step) for e in np.eye(n)]
    assert np.allclose(found[counts], np.stack(differences, axis=1)[counts], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_slopes_of_a_gaussian_are_linear_everywhere(n):
    field = field_of(lambda d: -0.5 * (d**2).sum(axis=1), n, 4.5)
    d = np.random.default_rng(n).uniform(-12.0, 12.0, (200, n))
    assert np.allclose(slopes_at(field, d)[0], -d, atol=1e-9)


def test_states_beyond_all_numbers_have_no_slope():
    field = field_of(bumpy, 2, 5.0)
    Y = np.array([[1e200, 0.0], [np.nan, 0.0], [np.inf, -np.inf]])
    owner, found = np.empty(3, np.int64), np.ones((3, 2))
    slopes(field, stencils(2), Y, owner, found)
    assert not found.any()
    assert np.all((owner >= 0) & (owner < len(field.node)))


@pytest.mark.parametrize(("n", "radius"), SIZES)
def test_noise_never_rises_above_the_cap_where_no_node_lies(n, radius):
    """In the cells of its nodes a field is as it was fitted."""
    rng, node = np.random.default_rng(3), disc(n, radius)
    noisy = rng.normal(size=len(node)) - 0.3 * (node**2).sum(axis=1)
    field = field_of(lambda d: noisy, n, radius)
    d = rng.uniform(-radius - 3.0, radius + 3.0, (4000, n))
    nodes = {tuple(row) for row in node}
    lies = np.array([tuple(cell) in nodes for cell in np.floor(d + 0.5).astype(int)])
    found, fitted = ask(field, d), ask(field._replace(cap=np.inf), d)
    assert found[~lies].max() <= field.cap < fitted[~lies].max()
    assert np.array_equal(found, np.where(lies, fitted, np.minimum(fitted, field.cap)))


@pytest.mark.parametrize(("n", "radius"), SIZES)
@pytest.mark.parametrize("reach", [3.0, 4.0, 5.5])
def test_the_cap_takes_nothing_from_a_gaussian(n, radius, reach):
    """Round in units of the lattice, as densities are: it is below the cap wherever no node lies."""

    def log_p(d):
        return 0.7 - 0.5 * (reach / radius) ** 2 * (d**2).sum(axis=1)

    field = field_of(log_p, n, radius)
    d = np.random.default_rng(n).uniform(-radius - 3.0, radius + 3.0, (4000, n))
    outside = log_p(d)[~owners(field, d)[1]]
    assert outside.max() < field.cap
    assert field.cap < log_p(np.zeros((1, n)))[0]
