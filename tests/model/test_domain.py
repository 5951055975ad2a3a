"""Domains: densities on circles and between walls against closed forms, and what leaves a bounded axis."""

import pickle

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.core.domain import view_of
from sphfilter.core.sph import kernels, neighbors
from sphfilter.core.sph.summation import density_and_gradient

PERIOD = 2.0 * np.pi
CIRCLE = sf.Domain(("periodic", -np.pi, np.pi))
SUMS = sf.SolverConfig(scheme=sf.PaperScheme(kernel="wendland_c2"))


def brownian(domain, drift="0.7"):
    return sf.SDE.from_expressions(["a"], [drift], noise=[[1.0]], spectral_density=[[0.5]], domain=domain)


def wrapped_normal(a, mean, variance):
    turns = PERIOD * np.arange(-8, 9)
    return np.exp(-0.5 * (a[:, None] + turns - mean) ** 2 / variance).sum(axis=1) / np.sqrt(PERIOD * variance)


@pytest.mark.parametrize(("config", "most"), [(sf.SolverConfig(), 1e-4), (SUMS, 0.03)])
def test_drifting_gaussian_on_a_circle(config, most):
    start = sf.initialize(sf.Gaussian([2.5], [[0.25]]), 80, config, domain=CIRCLE)
    end = sf.propagate(start, brownian(CIRCLE), [0.5, 2.0], config).densities[-1]
    a = np.linspace(-np.pi, np.pi, 101)
    exact = wrapped_normal(a, 2.5 + 1.4, 0.25 + 1.0)
    assert np.abs(end.pdf(a[:, None]) - exact).max() < most * exact.max()
    assert end.mean()[0] == pytest.approx(2.5 + 1.4 - PERIOD, abs=0.01)
    assert end.pdf(a[:, None] + PERIOD) == pytest.approx(end.pdf(a[:, None]))
    inside = sf.Domain(*CIRCLE.axes).contains(end.sample(200, rng=1))
    assert inside.all()


def test_the_seam_of_a_circle_can_lie_anywhere():
    results = []
    for low in (-np.pi, -0.4):
        domain = sf.Domain(("periodic", low, low + PERIOD))
        start = sf.initialize(sf.Gaussian([2.0], [[0.1]]), 60, SUMS, domain=domain)
        end, _ = sf.predict(start, brownian(domain, "sin(a)"), 0.5, SUMS)
        results.append(end.pdf(np.linspace(-3.0, 3.0, 50)[:, None]))
    assert results[0] == pytest.approx(results[1], rel=1e-9)


@pytest.mark.parametrize("config", [sf.SolverConfig(), pytest.param(SUMS, marks=pytest.mark.slow)])
def test_a_pendulum_comes_to_the_gibbs_density(config):
    damping, intensity = 1.0, 2.0
    domain = sf.Domain(("periodic", -np.pi, np.pi), None)
    model = sf.SDE.from_expressions(
        ["a", "w"], ["w", "-w - sin(a)"], noise=[[0], [1]], spectral_density=[[intensity]], domain=domain
    )
    start = sf.initialize(sf.Gaussian([2.5, 1.0], 0.25 * np.eye(2)), 400, config, domain=domain)
    end = sf.propagate(start, model, [3.0, 8.0], config).densities[-1]
    a, w = np.meshgrid(np.linspace(-np.pi, np.pi, 41)[:-1], np.linspace(-5, 5, 51), indexing="ij")
    X, cell = np.column_stack([a.ravel(), w.ravel()]), PERIOD / 40 * 0.2
    gibbs = np.exp(-2 * damping / intensity * (0.5 * X[:, 1] ** 2 - np.cos(X[:, 0])))
    gibbs /= gibbs.sum() * cell
    assert np.abs(end.pdf(X) - gibbs).sum() * cell < (0.02 if config is not SUMS else 0.12)


def test_a_cloud_on_a_circle_is_put_on_a_new_lattice():
    start = sf.initialize(sf.Gaussian([3.0], [[0.2]]), 60, SUMS, domain=CIRCLE)  # across the seam
    new, _ = sf.resample(start, 50, SUMS)
    assert new.domain == CIRCLE and CIRCLE.contains(new.x).all() and np.abs(new.x).max() <= np.pi
    assert new.mean() == pytest.approx(start.mean(), abs=1e-3)
    ring = sf.initialize(sf.Gaussian([3.0], [[9.0]]), 60, SUMS, domain=CIRCLE)  # all the way round
    again, info = sf.resample(ring, 60, SUMS)
    assert info.spacing[0] * info.lattice_dims[0] == pytest.approx(PERIOD)
    a = np.linspace(-np.pi, np.pi, 41)[:, None]
    assert again.pdf(a) == pytest.approx(wrapped_normal(a[:, 0], 3.0, 9.0), rel=0.02)


def test_a_uniform_ring_has_the_density_of_the_ring_and_no_support_beyond_half_of_it():
    x = (np.arange(10.0)[:, None] + 0.5) / 10.0
    domain = sf.Domain(("periodic", 0.0, 1.0))
    model = brownian(domain, "0")
    ring = sf.ParticleDensity(
        x=x, mass=np.full(10, 0.1), h=np.full(10, 2.0), kernel="gaussian", domain=domain
    )
    end, _ = sf.predict(ring, model, 0.1, SUMS)
    assert end.sph_kernel.radius * end.h.max() <= 0.5 + 1e-12
    assert end.pdf(np.linspace(0, 1, 7)[:, None]) == pytest.approx(1.0, rel=1e-3)


def test_images_are_the_particles_of_an_unrolled_copy():
    rng = np.random.default_rng(3)
    x, m, h = rng.random((40, 2)), np.full(40, 1 / 40), np.full(40, 0.05)
    domain = sf.Domain(("periodic", 0.0, 1.0), ("reflecting", 0.0, 1.0))
    turns = [(1.0, s, 0.0) for s in (-1.0, 0.0, 1.0)] + [
        (-1.0, s, 2.0 * wall) for s in (-1.0, 0.0, 1.0) for wall in (0.0, 1.0)
    ]
    copies = np.concatenate([np.column_stack([x[:, 0] + s, sign * x[:, 1] + off]) for sign, s, off in turns])
    order = np.argsort(~(copies[:, None] == x).all(axis=2).any(axis=1), kind="stable")
    copies = copies[order]
    own = np.concatenate([np.flatnonzero((copies[:40] == row).all(axis=1)) for row in x])
    found = []
    view = view_of(domain.codes, x, m, h, 0.2)
    for y, mass, length in (
        (view.x, view.m, view.h),
        (copies, np.full(len(copies), 1 / 40), np.full(len(copies), 0.05)),
    ):
        reach = 4 * length
        lists = neighbors.neighbor_lists(y, reach, reach.copy(), 0, neighbors.build_index(y, 0.2, 0))
        rho, grad, r = np.empty(len(y)), np.empty((len(y), 2)), np.empty(lists[1].size)
        density_and_gradient(y, mass, length, lists, (0, kernels.normalisation(0, 2)), rho, grad, r)
        found.append((rho[:40], grad[:40]))
    assert found[0][0] == pytest.approx(found[1][0][own], rel=1e-12)
    assert found[0][1] == pytest.approx(found[1][1][own], rel=1e-9, abs=1e-9)


def test_brownian_motion_between_reflecting_walls():
    domain = sf.Domain(("reflecting", 0.0, 1.0))
    model = brownian(domain, "0")
    assert not model.linear  # no closed form knows the walls
    start = sf.initialize(sf.Gaussian([0.2], [[0.01]]), 120, domain=domain)
    end, info = sf.predict(start, model, 0.2)
    assert info.scheme == "log_density" and info.status == "ok"
    a, images_ = np.linspace(0, 1, 41), 2.0 * np.arange(-4, 5)
    variance = 0.01 + 0.5 * 0.2
    exact = sum(
        np.exp(-0.5 * (a[:, None] - side * 0.2 - images_) ** 2 / variance).sum(axis=1) for side in (1, -1)
    ) / np.sqrt(PERIOD * variance)
    assert np.abs(end.pdf(a[:, None]) - exact).max() < 0.03 * exact.max()
    assert end.pdf([[-0.1], [1.1]]) == pytest.approx(0.0)
    assert end.x.min() >= 0 and end.x.max() <= 1


def test_a_particle_that_leaves_a_bounded_axis_stops_the_prediction():
    domain = sf.Domain(("bounded", -5.0, 4.0))
    start = sf.initialize(sf.Gaussian([0.0], [[0.3]]), 60, domain=domain)
    with pytest.raises(sf.PropagationError, match=r"left the domain at t = .*axis 0 is bounded by -5 and 4"):
        sf.predict(start, brownian(domain, "3.0"), 2.0)
    kept, _ = sf.predict(start, brownian(domain, "0.1"), 0.2)
    assert kept.mean()[0] == pytest.approx(0.02, abs=1e-3)
    with pytest.raises(sf.PropagationError, match="a path left the domain"):
        sf.simulate(brownian(domain, "3.0"), None, [0.0], [0.0, 5.0], rng=1)


def test_paths_stay_in_the_domain():
    domain = sf.Domain(("reflecting", 0.0, None))
    truth, _ = sf.simulate(brownian(domain, "-1"), None, [0.1], [0.0, 1.0, 2.0], rng=1, n_paths=200)
    assert truth.min() >= 0
    truth, _ = sf.simulate(brownian(CIRCLE, "3"), None, [0.1], [0.0, 5.0], rng=1, n_paths=50)
    assert np.abs(truth).max() <= np.pi
    # exponential steady state of a drift -1 against noise 1/2: mean q / 2
    truth, _ = sf.simulate(
        brownian(domain, "-1"), None, [0.2], [0.0, 4.0], rng=2, n_paths=4000, max_step=2e-3
    )
    assert truth[:, -1].mean() == pytest.approx(0.25, abs=0.03)


def test_a_filter_with_an_angle_that_goes_round():
    domain = sf.Domain(("periodic", -np.pi, np.pi))
    sensor = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.04]], angles=[0])
    flt = sf.SPHFilter(brownian(domain), sensor, [3.0], [[0.2]], n_particles=80)
    for k in range(1, 5):
        flt.predict(0.5)
        flt.update([np.angle(np.exp(1j * (3.0 + 0.35 * k)))])
    assert np.abs(np.angle(np.exp(1j * (flt.x[0] - 3.0 - 1.4)))) < 0.1
    assert flt.density.domain == domain and -np.pi <= flt.x[0] < np.pi


@pytest.mark.parametrize(
    ("axes", "sentence"),
    [
        ([("periodc", 0, 1)], "did you mean 'periodic'"),
        ([("periodic", 1, 0)], "must rise from low to high"),
        ([("periodic", 0, None)], "finite if it is periodic"),
        ([("bounded", 0)], "must be None or"),
        ([None, None], "2 axes, but there are 1 states"),
    ],
)
def test_a_domain_that_is_none(axes, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        brownian(axes)


def test_particles_beyond_the_walls_are_refused():
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), 40)
    with pytest.raises(sf.ModelError, match="beyond the walls"):
        sf.predict(start, brownian(sf.Domain(("reflecting", 0.0, None))), 1.0)


def test_domains_are_values():
    assert pickle.loads(pickle.dumps(CIRCLE)) == CIRCLE and hash(CIRCLE) == hash(sf.Domain(*CIRCLE.axes))
    model = pickle.loads(pickle.dumps(brownian(CIRCLE)))
    assert model.domain == CIRCLE and "periodic" in repr(CIRCLE)
    assert abs(CIRCLE.mean(np.array([[3.0], [-3.0]]), np.array([0.5, 0.5]))[0]) == pytest.approx(np.pi)
