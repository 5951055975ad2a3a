"""`initialize(spacing=)`: the lattices of 000 node by node, and what a spacing cannot be."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.lattice.regular import Lattice

THESIS = sf.SolverConfig(scheme=sf.PaperScheme(kernel="gaussian", support_range=(3.6, 3.6)))
SQUARE = [[-1.2, 1.2], [-1.2, 1.2]]


def ball(radius, variance):
    def pdf(X):
        r2 = (X**2).sum(axis=1)
        return np.where(r2 < radius**2, np.exp(-0.5 * r2 / variance), 0.0)

    return pdf


@pytest.mark.parametrize(
    ("radius", "variance", "box", "spacing", "published"),
    [
        (1.2, 0.09, SQUARE, 0.05, 1789),  # 000 4.2: 49 nodes a side
        (1.2, 0.09, [[-1.5, 1.5], [-1.5, 1.5]], 0.05, 1789),  # 000 appendix B
        (1.2, 0.09, SQUARE, 1.2 / 36, 4049),  # 000 4.2 with two wells: 73 nodes, not the printed 97
        (4.0, 1.0, [[-4, 4]] * 3, 8 / 27, 10144),  # 000 4.3: 28 nodes
        (4.0, 1.0, [[-4, 4]] * 3, 0.3, 10144),  # which does not fit, and is lowered to 8/27
    ],
)
def test_cut_lattices_have_the_published_numbers_of_particles(radius, variance, box, spacing, published):
    density = sf.initialize(ball(radius, variance), box=box, spacing=spacing, config=THESIS)
    assert density.n_particles == density.capacity == published
    assert np.linalg.norm(density.x, axis=1).max() < radius
    expected = np.exp(-0.5 * (density.x**2).sum(axis=1) / variance)
    assert density.mass == pytest.approx(expected / expected.sum(), rel=1e-12)


@pytest.mark.parametrize("config", [THESIS, None], ids=["paper", "auto"])
def test_a_uniform_start_has_equal_masses_and_nodes_at_both_ends(config):
    """000 4.4: 9 nodes along S and I, 3 along the others; the variance of k nodes is (k² - 1)/12 ds²."""
    box = np.array([[0.88, 0.92], [0.03, 0.07], [0.0025, 0.0125], *[[-0.005, 0.005]] * 3])
    density = sf.initialize(sf.Uniform(box), spacing=0.005, config=config)
    assert density.n_particles == 6561
    assert np.unique(density.mass).size == 1
    assert np.transpose([density.x.min(axis=0), density.x.max(axis=0)]) == pytest.approx(box, abs=1e-12)
    k = np.array([9, 9, 3, 3, 3, 3])
    assert np.diag(density.cov("points")) == pytest.approx((k**2 - 1) / 12 * 0.005**2)


def test_the_coupling_is_the_smoothing_length_over_the_spacing():
    """000 3.7.2: h = 1.2 dx, here as a support range of kappa eta, for each kernel."""
    for kernel, kappa in {"gaussian": 3.0, "cubic": 2.0, "lucy": 1.0}.items():
        scheme = sf.PaperScheme(kernel=kernel, support_range=(1.2 * kappa, 1.2 * kappa))
        density = sf.initialize(sf.Uniform(SQUARE), spacing=0.1, config=sf.SolverConfig(scheme=scheme))
        assert density.h == pytest.approx(0.12)
    swept = sf.initialize(sf.Uniform(SQUARE), spacing=0.1, config=sf.SolverConfig.paper())
    assert 0.2 < swept.h[0] < 0.31  # 002 4.6.1: between the ends of its range


def test_a_spacing_for_each_axis_and_a_gaussian_on_a_box_of_its_own():
    """001 4.2: 50 x 33 nodes on four standard deviations."""
    gaussian = sf.Gaussian([0.0, 0.0], np.diag([0.15, 0.1]) ** 2)
    box = [[-0.6, 0.6], [-0.4, 0.4]]
    density = sf.initialize(gaussian, box=box, spacing=[1.2 / 49, 0.8 / 32], config=THESIS)
    assert density.n_particles == 1650
    assert density.cov("points") == pytest.approx(gaussian.cov, abs=3e-5)


def test_walls_and_circles_are_laid_with_whole_cells():
    axes = [("periodic", -np.pi, np.pi), ("reflecting", 0.0, None)]
    box = [[-np.pi, np.pi], [0.0, 1.0]]
    density = sf.initialize(sf.Uniform(box), spacing=[0.5, 0.25], config=THESIS, domain=axes)
    angles, heights = (np.unique(x.round(9)) for x in density.x.T)
    assert len(angles) == 13 and np.diff(angles) == pytest.approx(2 * np.pi / 13)
    assert heights == pytest.approx([0.125, 0.375, 0.625, 0.875])


def test_a_spacing_is_kept_or_lowered():
    for span, spacing, count in [(1.0, 0.25, 5), (1.0, 0.3, 5), (1.0, 1.0, 2), (2.4, 0.05, 49)]:
        lattice = Lattice.spaced(np.zeros(1), np.array([span]), np.array([spacing]))
        assert lattice.dims == [count]
        assert lattice.nodes[[0, -1], 0] == pytest.approx([0.0, span])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"spacing": -0.1}, r"spacing must be positive .* \[2.4, 2.4\], got \[-0.1, -0.1\]"),
        ({"spacing": 2.5}, "no longer than the sides of the box"),
        ({"spacing": [0.1]}, "spacing has shape"),
        ({"spacing": "fine"}, "spacing must be"),
        ({"spacing": 1e-4}, "nodes, more than 2e"),
        ({"spacing": 0.1, "n_particles": 100}, "lays 625 particles, more than n_particles = 100"),
        ({"spacing": 0.1, "config": sf.SolverConfig(scheme="log_density")}, "spacing is for schemes"),
    ],
)
def test_bad_spacings(options, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        sf.initialize(sf.Uniform(SQUARE), **options)


def test_a_lattice_moves_with_both_schemes_that_take_it():
    """The linear Duffing oscillator of 000 4.2 from its lattice, beside the closed form (van Loan)."""
    model = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.4]], noise=[[0.0], [1.0]], spectral_density=[[1.0]])
    gaussian = sf.Gaussian([0.0, 0.0], 0.09 * np.eye(2))
    start = sf.initialize(gaussian, 400)
    exact = sf.propagate(start, model, 1.0, sf.SolverConfig(exact_linear=True)).densities[0].cov()
    thesis = sf.PaperScheme(
        kernel="gaussian", support_range=(3.6, 3.6), smoothing="fixed_point", smoothing_iterations=1,
        cfl="fixed", dt_max=0.005,
    )  # fmt: skip
    for scheme, spacing, most in ((thesis, 0.1, 0.06), (thesis, 0.05, 0.015), ("auto", 0.1, 2e-3)):
        config = sf.SolverConfig(scheme=scheme)
        density = sf.initialize(gaussian, box=SQUARE, spacing=spacing, config=config)
        assert density.n_particles == round(2.4 / spacing + 1) ** 2
        moved = sf.propagate(density, model, 1.0, config).densities[0]
        assert moved.cov("points") == pytest.approx(exact, rel=most, abs=most * exact[1, 1])
