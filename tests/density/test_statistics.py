"""Quantiles, entropies, regions, marginals and tails of densities, against Gaussians and sums of them."""

import itertools
import math

import numpy as np
import pytest
from density_cases import duffing
from scipy import integrate, optimize, stats

import sphfilter as sf
from sphfilter.core.sph import kernels

MEAN, COV = np.array([1.0, -2.0]), np.array([[2.0, 0.6], [0.6, 1.0]])
PARTS = 0.4, 0.6
CENTRES = np.array([-2.5, 2.0])


def cloud(log_p, low, high, spacing, kernel="wendland_c2", support=3.5, **more):
    """Particles on a lattice of a box, with the log-density they carry."""
    axes = [np.arange(a, b, spacing) for a, b in zip(low, high, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    values = log_p(x)
    h = np.full(len(x), support * spacing / kernels.RADIUS[kernels.KINDS.index(kernel)])
    kept = values > values.max() - 14.0
    return sf.ParticleDensity(
        x=x[kept], mass=np.exp(values[kept]), h=h[kept], kernel=kernel, log_density=values[kept], **more
    )


def two_gaussians(y):
    """Two pieces along the first axis; along others a standard normal."""
    first = np.log(sum(w * stats.norm.pdf(y[:, 0], c, 0.7) for w, c in zip(PARTS, CENTRES, strict=True)))
    return first + stats.norm.logpdf(y[:, 1:]).sum(axis=1)


def two_quantile(p):
    def off(x):
        return PARTS @ stats.norm.cdf(x, CENTRES, 0.7) - p

    return optimize.brentq(off, -8, 8)


def two_entropy():
    x = np.linspace(-8, 8, 20_001)
    log_p = two_gaussians(x[:, None])
    return -integrate.trapezoid(np.exp(log_p) * log_p, x)


@pytest.fixture(scope="module")
def gaussians():
    """One Gaussian in all read-outs, with the error in standard deviations that each may have."""
    exact = stats.multivariate_normal(MEAN, COV)
    box = MEAN - 6.0 * np.sqrt(np.diag(COV)), MEAN + 6.0 * np.sqrt(np.diag(COV))
    points = cloud(exact.logpdf, *box, 0.25, read_out="points")
    wide = cloud(exact.logpdf, *box, 0.2, "gaussian", 4.5)
    blurred = COV + 0.5 * wide.h[0] ** 2 * np.eye(2)
    return {
        "log_density": (sf.initialize(sf.Gaussian(MEAN, COV), 300), COV, 1e-3),
        "points": (points, COV, 0.04),
        "mixture": (wide, blurred, 2e-3),  # a sum of Gaussians but for their cut
    }


READ_OUTS = ["points", "mixture", "log_density"]


# one Gaussian


@pytest.mark.parametrize("kind", READ_OUTS)
def test_quantiles_of_a_gaussian(gaussians, kind):
    density, cov, most = gaussians[kind]
    probability = np.array([1e-4, 0.01, 0.3, 0.5, 0.9, 0.999])
    for axis in (0, 1):
        found = density.quantile(axis, probability, kind)
        exact = stats.norm.ppf(probability, MEAN[axis], np.sqrt(cov[axis, axis]))
        assert found == pytest.approx(exact, abs=3 * most * np.sqrt(cov[axis, axis]) + 1e-9)
    one = density.quantile(1, 0.3, kind)
    assert isinstance(one, float)
    assert one == found[2]


@pytest.mark.parametrize("kind", READ_OUTS)
def test_entropy_of_a_gaussian(gaussians, kind):
    density, cov, most = gaussians[kind]
    assert density.entropy(kind) == pytest.approx(stats.multivariate_normal(MEAN, cov).entropy(), abs=most)


@pytest.mark.parametrize("kind", READ_OUTS)
@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_regions_of_a_gaussian(gaussians, kind, probability):
    """Ellipses that hold P have r² = -2 log(1 - P), exp(-r²/2) of the peak at their edge, area pi r² |L|."""
    density, cov, most = gaussians[kind]
    region = density.hpd_region(probability, kind)
    area, peak = np.pi * np.sqrt(np.linalg.det(cov)), 1.0 / (2.0 * np.pi * np.sqrt(np.linalg.det(cov)))
    assert region.volume == pytest.approx(-2.0 * area * np.log(1 - probability), rel=max(0.01, 2 * most))
    if kind != "points":  # which know the level to a particle
        assert region.level == pytest.approx((1 - probability) * peak, rel=0.03)
        assert density.probability(region, kind) == pytest.approx(probability, abs=0.005)
    radius = np.sqrt(-2.0 * np.log(1 - probability))
    root = np.linalg.cholesky(cov)
    ring = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 6, 9)])
    assert region(MEAN + 0.93 * radius * ring @ root.T).all()
    assert not region(MEAN + 1.07 * radius * ring @ root.T).any()


def test_a_density_s_own_kind_is_what_it_is_read_as():
    points = cloud(lambda y: stats.norm.logpdf(y[:, 0]), [-6], [6], 0.2)
    assert points.quantile(0, 0.9) == points.quantile(0, 0.9, "mixture")
    assert points.entropy() == points.entropy("mixture") > points.entropy("points")


# two pieces


@pytest.mark.parametrize(("kind", "most"), [("points", 0.03), ("mixture", 0.06), ("log_density", 2e-3)])
def test_two_pieces(kind, most):
    if kind == "log_density":
        density = sf.initialize(lambda X: np.exp(two_gaussians(X)), 150, box=[[-8, 8]])
    else:
        density = cloud(two_gaussians, [-7], [7], 0.13, read_out=kind)
    for p in (0.02, 0.2, 0.39, 0.41, 0.7, 0.99):
        slope = PARTS @ stats.norm.pdf(two_quantile(p), CENTRES, 0.7)
        assert density.quantile(0, p, kind) == pytest.approx(two_quantile(p), abs=most * min(1 / slope, 4))
    assert density.entropy(kind) == pytest.approx(two_entropy(), abs=most)
    region = density.hpd_region(0.9, kind)
    inside = region(np.array([[-2.5], [-0.3], [2.0], [5.0]]))
    assert inside.tolist() == [True, False, True, False]
    y = np.linspace(-8, 8, 8001)
    p = np.exp(two_gaussians(y[:, None]))
    exact = np.sort(p)[::-1]
    size = np.searchsorted(np.cumsum(exact) * (y[1] - y[0]), 0.9) * (y[1] - y[0])
    assert region.volume == pytest.approx(size, rel=max(2 * most, 0.015))


DAMPER = {"xi": 0.01, "w0": np.pi, "eta": 0.25, "al": 0.35}


@pytest.mark.slow
def test_tails_of_a_damped_oscillator_under_modulated_noise():
    """P(|q| > T) at t = 6 by six million paths of order two, by as many points as see them."""
    model = sf.SDE.from_expressions(
        ["q", "v"],
        ["v", "-2*xi*w0*v - eta*sign(v)*abs(v)**al - w0**2*q"],
        [["0"], ["where(t <= 2, t/2, where(t < 6, 1, exp(2*(6 - t))))"]],
        [[0.4]],
        DAMPER,
    )
    config = sf.SolverConfig(scheme=sf.CloudScheme(n_points=200_000))
    begun = sf.initialize(sf.Gaussian([0, 0], np.diag([0.15**2, 0.1**2])))
    density, _ = sf.predict(begun, model, 6.0, config)
    thresholds = [0.365, 0.598, 0.787, 0.940, 1.057]
    exact = np.array([0.1005, 0.01019, 1.011e-3, 1.17e-4, 1.83e-5])
    found = np.array([density.probability(lambda X, T=T: abs(X[:, 0]) > T) for T in thresholds])
    assert np.all(np.abs(found / exact - 1.0) < [0.02, 0.03, 0.06, 0.3, 0.8])


@pytest.mark.parametrize("start", [0.0, 1.7])  # with noise of its own
@pytest.mark.parametrize(("stiffness", "width"), [(0.1, 8.0), (1.0, 3.5)])
def test_a_cloud_where_two_wells_have_mixed(stiffness, width, start):
    """Steady state of a Duffing oscillator: exp(-(2c/q)(v²/2 - x²/2 + e x⁴/4)), after many turns."""
    model = sf.SDE.from_expressions(
        ["x", "v"], ["v", "-0.4*v - x*(-1 + e*x**2)"], [["0"], ["1"]], [[1.0]], {"e": stiffness}
    )
    begun = sf.initialize(sf.Gaussian([0, 0], 0.09 * np.eye(2)), 300, t=start)
    density, _ = sf.predict(begun, model, start + 30.0, sf.SolverConfig(scheme="cloud"))
    x, v = np.linspace(-width, width, 101), np.linspace(-5.5, 5.5, 101)
    X = np.stack(np.meshgrid(x, v, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = (x[1] - x[0]) * (v[1] - v[0])
    energy = 0.5 * X[:, 1] ** 2 - 0.5 * X[:, 0] ** 2 + 0.25 * stiffness * X[:, 0] ** 4
    exact = np.exp(-0.8 * energy)
    exact /= exact.sum() * cell
    assert np.abs(density.pdf(X) - exact).sum() * cell < 0.06


# log-densities on a lattice


@pytest.mark.parametrize(
    ("n", "N", "axes"),
    [(2, 200, [0]), (2, 200, [1]), (2, 200, [1, 0]), (3, 400, [1]), (3, 400, [2, 0]), (4, 800, [3]),
     (4, 800, [2, 1]), (4, 800, [0, 2, 1]), (5, 2000, [3])],
)  # fmt: skip
def test_marginals_of_a_log_density(n, N, axes):
    """Right to a thousandth of the peak, and log p to its last node."""
    root = np.random.default_rng(n).normal(size=(n, n)) + 2.0 * np.eye(n)
    mean, cov = np.arange(n) - 1.0, root @ root.T
    one = sf.initialize(sf.Gaussian(mean, cov), N).marginal(axes)
    exact = stats.multivariate_normal(mean[axes], cov[np.ix_(axes, axes)])
    Y = np.concatenate([one.x, one.x + 0.4 * one.field.A.sum(axis=1)])
    off = one.logpdf(Y) - exact.logpdf(Y if len(axes) > 1 else Y[:, 0])
    depth = np.log(exact.pdf(exact.mean)) - exact.logpdf(Y if len(axes) > 1 else Y[:, 0])
    assert np.abs(off[depth < 7.0]).max() < 0.01
    assert np.abs(np.expm1(off) * np.exp(-depth)).max() < 1e-3
    assert one.mean() == pytest.approx(mean[axes], abs=1e-4)
    assert one.cov() == pytest.approx(cov[np.ix_(axes, axes)], rel=2e-3, abs=2e-3)
    assert one.gaussian
    assert one.probability(lambda X: np.ones(len(X), bool)) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def bent():
    """A Duffing oscillator's density after a fold begins."""
    begun = sf.initialize(sf.Gaussian([0.2, 2.0], 0.3 * np.eye(2)), 600)
    return sf.predict(begun, duffing(), 1.2)[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_marginals_of_a_bent_log_density(bent, axis):
    one = bent.marginal([axis])
    s = np.linspace(-12, 12, 1201)
    y = np.linspace(one.x.min(), one.x.max(), 60)
    X = np.empty((60, len(s), 2))
    X[..., axis], X[..., 1 - axis] = y[:, None], s
    exact = integrate.trapezoid(bent.pdf(X.reshape(-1, 2)).reshape(60, -1), s, axis=1)
    assert np.abs(one.logpdf(y[:, None]) - np.log(exact)).max() < 0.05
    assert np.abs(one.pdf(y[:, None]) - exact).max() < 1e-3 * exact.max()
    edges = one.quantile(0, np.array([0.01, 0.2, 0.5, 0.8, 0.99]))
    assert edges == pytest.approx(bent.quantile(axis, np.array([0.01, 0.2, 0.5, 0.8, 0.99])), abs=1e-6)
    for edge in edges:
        direct = bent.probability(lambda X, edge=edge: X[:, axis] > edge)
        assert direct == pytest.approx(
            one.probability(lambda X, edge=edge: X[:, 0] > edge), rel=0.02, abs=2e-4
        )


def test_a_marginal_has_the_pieces_of_its_density():
    density = sf.initialize(lambda X: np.exp(two_gaussians(X)), 1500, box=[[-8, 8], [-6, 6]])
    y = np.linspace(-5.0, 4.5, 50)[:, None]
    exact = np.exp(two_gaussians(y))
    first, second = density.marginal([0]), density.marginal([1])
    assert np.abs(first.pdf(y) - exact).max() < 4e-3 * exact.max()
    assert np.abs(second.pdf(y) - stats.norm.pdf(y[:, 0])).max() < 1e-3
    assert density.quantile(0, 0.2) == pytest.approx(two_quantile(0.2), abs=2e-3)


def test_a_marginal_of_all_states_is_the_density(bent):
    other = bent.marginal([1, 0])
    X = bent.x[::7] + 0.01
    assert other.pdf(X[:, ::-1]) == pytest.approx(bent.pdf(X), abs=2e-3 * bent.pdf(X).max())


@pytest.mark.parametrize("reach", [None, 6.5])
def test_tails_beyond_the_cut_of_a_lattice(reach):
    """P(|x| > T) of a linear oscillator; the lattice of a filter ends at 4.2 standard deviations."""
    model = sf.LinearSDE(A=[[0, 1], [-1, -0.2]], noise=[[0], [1]], spectral_density=[[1.0]])
    config = sf.SolverConfig(scheme=sf.LogDensityScheme(reach=reach), exact_linear=False)
    begun = sf.initialize(sf.Gaussian([1.0, 1.0], 0.01 * np.eye(2)), 400, config)
    density, info = sf.predict(begun, model, 10.0, config)
    assert info.scheme == "log_density"
    thresholds = 2.55099, 3.97794, 5.06346, 5.96888, 6.75955, 7.46931
    for decade, T in enumerate(thresholds, start=1):
        found = density.probability(lambda X, T=T: np.abs(X[:, 0]) > T)
        assert found == pytest.approx(10.0**-decade, rel=0.02)
    sigma = np.sqrt(2.131923)
    assert density.quantile(0, 1e-7) == pytest.approx(-0.522197 + sigma * stats.norm.ppf(1e-7), abs=0.01)
    assert density.probability(lambda X: X[:, 0] < 1e9) == pytest.approx(1.0)
    for power, factor in ((2, 1), (4, 3), (6, 15)):
        exact = factor * density.cov()[0, 0] ** (power // 2)
        assert density.moment([power, 0], central=True) == pytest.approx(exact, rel=1e-3)


# moments of kernels


@pytest.mark.parametrize("kernel", kernels.KINDS)
@pytest.mark.parametrize("n", [1, 2, 3])
def test_moments_of_one_kernel(kernel, n):
    one = sf.ParticleDensity(x=np.zeros((1, n)), mass=[1.0], h=[0.7], kernel=kernel, read_out="mixture")
    code, reach = one.sph_kernel.kind, kernels.RADIUS[kernels.KINDS.index(kernel)]

    def radial(power):
        pieces = itertools.pairwise(np.arange(reach + 1))
        return sum(integrate.quad(lambda q: kernels.shape(code, q) * q**power, a, b)[0] for a, b in pieces)

    assert one.moment([2] + [0] * (n - 1)) == pytest.approx(one.kernel_variance * 0.49, rel=1e-9)
    fourth = 0.7**4 * radial(n + 3) / radial(n - 1) * 3.0 / (n * (n + 2))
    assert one.moment([4] + [0] * (n - 1)) == pytest.approx(fourth, rel=1e-7)
    if n > 1:
        assert one.moment([2, 2] + [0] * (n - 2)) == pytest.approx(fourth / 3.0, rel=1e-7)
        assert one.moment([1, 3] + [0] * (n - 2)) == 0.0


def test_moments_of_a_mixture_are_exact():
    rng = np.random.default_rng(0)
    density = sf.ParticleDensity(
        x=rng.normal(size=(30, 2)), mass=rng.random(30), h=rng.uniform(0.2, 1.0, 30), read_out="mixture"
    )
    X = density.sample(400_000, rng=2)
    for powers in ([1, 0], [1, 1], [2, 1], [3, 2], [4, 0], [2, 4]):
        found = density.moment(powers)
        values = np.prod(X ** np.array(powers), axis=1)
        assert abs(found - values.mean()) < 5.0 * values.std() / math.sqrt(len(X))
    mean = density.mean()
    assert density.moment([2, 0], central=True) == pytest.approx(density.cov()[0, 0], rel=1e-12)
    assert density.moment([2, 0]) == pytest.approx(density.cov()[0, 0] + mean[0] ** 2, rel=1e-12)


# domains


CIRCLE = sf.Domain(("periodic", -np.pi, np.pi))
SUMS = sf.SolverConfig(scheme=sf.PaperScheme(kernel="wendland_c2"))


@pytest.mark.parametrize(("config", "most"), [(None, 1e-3), (SUMS, 0.02)])
def test_quantiles_of_an_angle_count_from_its_low_end(config, most):
    """A normal distribution across the seam of a circle."""
    density = sf.initialize(sf.Gaussian([3.0], [[0.3]]), 100, config, domain=CIRCLE)
    turns = 2.0 * np.pi * np.arange(-6, 7)

    def part(a):
        return sum(np.diff(stats.norm.cdf([-np.pi, a], 3.0 + k, np.sqrt(0.3)))[0] for k in turns)

    for p in (0.1, 0.35, 0.5, 0.9):
        found = density.quantile(0, p)
        assert -np.pi <= found <= np.pi
        assert part(found) == pytest.approx(p, abs=most)
    x = np.linspace(-np.pi, np.pi, 4001)
    exact = sum(stats.norm.pdf(x, 3.0 + k, np.sqrt(0.3)) for k in turns)
    entropy = -integrate.trapezoid(exact * np.log(exact), x)
    assert density.entropy() == pytest.approx(entropy, abs=max(1.5 * most, 2e-3))
    region = density.hpd_region(0.8)
    assert region([[3.0], [-3.1], [0.0]]).tolist() == [True, True, False]
    assert density.probability(region) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("config", [None, SUMS])
def test_a_marginal_keeps_the_domain_of_its_axes(config):
    domain = sf.Domain(("periodic", -np.pi, np.pi), None)
    density = sf.initialize(sf.Gaussian([3.0, 1.0], [[0.3, 0.1], [0.1, 0.5]]), 600, config, domain=domain)
    angle, rate = density.marginal([0]), density.marginal([1])
    assert angle.domain == CIRCLE
    assert rate.domain is None
    a = np.linspace(-np.pi, np.pi, 50)
    exact = sum(stats.norm.pdf(a, 3.0 + k, np.sqrt(0.3)) for k in (-2 * np.pi, 0.0, 2 * np.pi))
    most = 2e-3 if config is None else 0.06
    assert np.abs(angle.pdf(a[:, None]) - exact).max() < most
    assert rate.quantile(0, 0.5) == pytest.approx(1.0, abs=0.01)
    assert density.marginal([1, 0]).domain == sf.Domain(None, ("periodic", -np.pi, np.pi))


@pytest.mark.parametrize("domain", [None, sf.Domain(("periodic", -np.pi, np.pi), *[None] * 5)])
def test_marginals_and_samples_of_many_gaussian_states_need_no_lattice(domain):
    """A lattice of six states took seconds a marginal, and a picture asks for dozens."""
    root = np.random.default_rng(6).normal(size=(6, 6)) / 6.0 + 0.5 * np.eye(6)
    cov = root @ root.T
    density = sf.initialize(sf.Gaussian(np.zeros(6), cov), "auto", domain=domain)
    one = density.marginal([0, 4])
    X = one.mean() + np.random.default_rng(1).normal(size=(50, 2)) * 0.5
    exact = stats.multivariate_normal(np.zeros(2), cov[np.ix_([0, 4], [0, 4])])
    np.testing.assert_allclose(one.logpdf(X), exact.logpdf(X), atol=1e-9 if domain is None else 2e-3)
    assert density.quantile(4, 0.975) == pytest.approx(1.95996 * cov[4, 4] ** 0.5, rel=2e-3)
    np.testing.assert_allclose(np.cov(density.sample(10_000, 1).T), cov, atol=0.03)
    assert "laid" not in vars(density.form.bare)


@pytest.mark.parametrize("domain", [None, sf.Domain(None, ("periodic", -np.pi, np.pi))])
def test_quantiles_of_what_has_no_width(domain):
    """Of one point, and of a state that is known, as of the cloud that a sharp reading leaves."""
    one = sf.ParticleDensity(x=[[1.0, 2.0]], mass=[1.0], h=[0.1], read_out="cloud", domain=domain)
    flat = sf.ParticleDensity(
        x=[[1.0, 2.0], [3.0, 2.0]], mass=[0.5, 0.5], h=[0.1, 0.1], read_out="cloud", domain=domain
    )
    for density in (one, flat):
        np.testing.assert_allclose(density.quantile(1, [0.1, 0.9]), 2.0, rtol=1e-15)
    assert one.quantile(0, 0.5) == 1.0
    assert flat.quantile(0, [0.1, 0.9]).tolist() == sorted(flat.quantile(0, [0.1, 0.9]))


def test_quantiles_between_walls():
    x = (np.arange(40.0)[:, None] + 0.5) / 40.0
    domain = sf.Domain(("reflecting", 0.0, 1.0))
    even = sf.ParticleDensity(x=x, mass=np.ones(40), h=np.full(40, 0.08), kernel="wendland_c2", domain=domain)
    for kind in ("points", "mixture"):
        assert even.quantile(0, np.array([0.02, 0.5, 0.97]), kind) == pytest.approx(
            [0.02, 0.5, 0.97], abs=2e-3
        )
    assert even.entropy() == pytest.approx(0.0, abs=2e-3)
    assert even.probability(lambda X: (X[:, 0] < 0) | (X[:, 0] > 1)) == 0.0


# refusals


def test_questions_that_have_no_answer(gaussians):
    density = gaussians["mixture"][0]
    for question, message in [
        (lambda: density.quantile(2, 0.5), "axes must be different numbers from 0 to 1"),
        (lambda: density.quantile(0, 0.0), "between 0 and 1"),
        (lambda: density.quantile(0, [0.5, np.nan]), "between 0 and 1"),
        (lambda: density.hpd_region(1.0), "between 0 and 1"),
        (lambda: density.entropy("mixtures"), "mixture"),
        (lambda: density.probability(lambda X: X[:, 0]), "a region returns booleans"),
        (lambda: density.sample(-3), "size must be a whole number"),
    ]:
        with pytest.raises(sf.ModelError, match=message):
            question()
