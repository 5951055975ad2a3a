"""What steps ask of a density's shape, of every representation."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.as_cloud import cloud_density
from sphfilter.density.as_family import gaussians_of, may_miss, pieces_density
from sphfilter.density.moments import moments
from sphfilter.density.pieces import Pieces
from sphfilter.lattice.level_set import usual_nodes

NORMAL = sf.Gaussian([0.5], [[0.4]])
FAMILY = sf.initialize(NORMAL, "auto")
TWO = Pieces(np.log([0.5, 0.5]), np.array([[0.0], [1.0]]), np.full((2, 1, 1), np.sqrt(0.15)))
DENSITIES = {
    "kernels": sf.initialize(NORMAL, 60, sf.SolverConfig(scheme="paper")),
    "cloud": cloud_density(FAMILY, FAMILY.sample(500, 1), np.full(500, 1.0 / 500)),
    "lattice": sf.initialize(NORMAL, 60),
    "family": FAMILY,
    "pieces": pieces_density(FAMILY, TWO),
    "family round a circle": sf.initialize(NORMAL, "auto", domain=[("periodic", -np.pi, np.pi)]),
}
KERNELS, FORMULAS = {"kernels", "cloud"}, {"family", "pieces", "family round a circle"}


@pytest.mark.parametrize("name", DENSITIES)
def test_kernels_end_somewhere_and_a_lattice_alone_has_cells(name):
    form, field = DENSITIES[name].form, DENSITIES[name].field
    assert form.smooth == (name not in KERNELS)
    assert (form.cell is None) == (name != "lattice")
    if name == "lattice":
        np.testing.assert_array_equal(form.cell, field.A)


@pytest.mark.parametrize("name", DENSITIES)
def test_a_formula_lies_on_as_many_nodes_as_are_asked_for(name):
    laid = DENSITIES[name].form.bare.on_lattice(80)
    assert (laid is None) == (name not in FORMULAS)
    if laid is not None:
        assert 40 < len(laid.x) <= 80
        np.testing.assert_allclose([laid.mean[0], laid.cov[0, 0]], [0.5, 0.4], rtol=1e-3)


@pytest.mark.parametrize("name", DENSITIES)
def test_a_shape_answers_what_steps_would_ask_its_name_for(name):
    form = DENSITIES[name].form
    assert form.degree == (2 if "family" in name else 0)
    assert [form.own_points is None, form.atoms is None] == [name != "cloud", name != "kernels"]
    assert form.nodes(7) == (usual_nodes(1) if name in FORMULAS else 7)
    assert (form.heaviest is None) == (name != "pieces")


@pytest.mark.parametrize("name", [name for name in DENSITIES if "circle" not in name])
def test_points_drawn_of_a_shape_have_its_mean_and_covariance(name):
    density = DENSITIES[name]
    x, w = density.form.drawn(200, 5)
    np.testing.assert_allclose(moments(x, w)[0], density.mean(), rtol=1e-9)
    np.testing.assert_allclose(moments(x, w)[1], density.cov(), rtol=1e-9)


def test_a_family_round_a_circle_lays_its_lattice_when_it_is_asked_for_a_density():
    density = sf.initialize(NORMAL, "auto", domain=[("periodic", -np.pi, np.pi)])
    assert density.form.smooth and "laid" not in vars(density.form.bare)
    assert density.mean()[0] == pytest.approx(0.5, abs=1e-6) and "laid" in vars(density.form.bare)
    assert density.pdf([0.5]) == pytest.approx(1.0 / np.sqrt(2.0 * np.pi * 0.4), rel=1e-3)


def test_what_is_known_to_be_gaussian_misses_nothing():
    assert [name for name, density in DENSITIES.items() if gaussians_of(density)] == ["family", "pieces"]
    assert not may_miss(FAMILY) and not may_miss(DENSITIES["lattice"])
    assert may_miss(FAMILY.noted(gaussian=False))


@pytest.mark.parametrize(("n", "count"), [(1, 512), (2, 4096)])
def test_points_of_a_lattice_know_of_a_mode_that_holds_next_to_nothing(n, count):
    """In a tail of 4e-7 one of 1e-4 or 1e-3: of 512 points none stood for it, where each weighs as much."""
    far, part = 5.0 * np.eye(n)[0], 10.0 ** (n - 5)

    def log_likelihood(z, X, t):
        at_rest, mode = np.sum(X**2, axis=1), np.sum((X - far) ** 2, axis=1) / 0.05
        return np.logaddexp(np.log(1.0 - part), np.log(part / 0.05 ** (n / 2)) + 0.5 * (at_rest - mode))

    sensor = sf.LikelihoodMeasurement(log_likelihood, peaks=lambda z: far[None])
    start = sf.initialize(sf.Gaussian(np.zeros(n), np.eye(n)), 400)
    density, _ = sf.update(start, sensor, [0.0])
    x, w = density.form.drawn(count, 3)
    assert w[x[:, 0] > 4.0].sum() == pytest.approx(part, rel=0.1)
    assert 1.0 / np.sum(w**2) > 0.85 * count
