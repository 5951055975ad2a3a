"""Paths of the noise and the expectation over them, against scipy's integrator and exact Gaussians."""

import numpy as np
import pytest
from lattices import disc
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal

import sphfilter as sf
from sphfilter.core._addresses import NOWHERE_AT, address_of, function_at
from sphfilter.core._jit import jit, start_threads
from sphfilter.core.characteristics import noise_paths
from sphfilter.core.characteristics.aim import aimed
from sphfilter.core.characteristics.expectation import EXPECTED, Step, back, back_in_blocks
from sphfilter.core.characteristics.noise_paths import ALONG, Begin, Noise, Pull, Span, along
from sphfilter.core.field.fitting import build_field
from sphfilter.core.field.stencils import stencils
from sphfilter.prediction.noise_rules import paths

SWING = sf.SDE.from_expressions(
    ["x", "v"], ["v + 0.1*sin(x*v)", "-(1 + 0.5*sin(2*t))*x - 0.2*x**2 - 0.3*v"], [["0"], ["1"]], [[0.5]]
)
RADIUS = {1: 5.0, 2: 4.5, 3: 3.5, 4: 3.2}  # of a lattice, in cells
REACH = 4.0  # and in standard deviations


@jit
def _ends(addresses, noise, x, t, h, parts, straight, bend):
    """Ends of paths and the integral of the divergence; the ends once more without that integral."""
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    f, d = np.empty_like(x), np.empty((x.shape[0], 1))
    drift(x, t, noise.p, f)
    divergence(x, t, noise.p, d)
    end, action, alone = np.empty_like(x), np.empty(x.shape[0]), np.empty_like(x)
    pull = Pull(straight, bend, straight[:0])
    begin, span = Begin(x, f, d), Span(t, h, parts)
    along(drift, divergence, noise, begin, span, pull, end, action)
    along(drift, drift, noise, begin, span, pull, alone, action[:0])
    return end, action, alone


@jit
def _blurred(addresses, noise, x, h, parts, blur):
    """Ends of paths, and integrals of the divergence, that average over a bridge and have no other noise."""
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    f, d, still = np.empty_like(x), np.empty((x.shape[0], 1)), noise_paths.unblurred(*x.shape)
    pull = Pull(still.straight, still.bend, blur)
    drift(x, 0.0, noise.p, f)
    divergence(x, 0.0, noise.p, d)
    end, action = np.empty_like(x), np.empty(x.shape[0])
    along(drift, divergence, noise, Begin(x, f, d), Span(0.0, h, parts), pull, end, action)
    return end, action


@jit
def _back(addresses, noise, field, sten, rule, times, parts, Y, floor, threads):
    """log p at the states Y at times[1], a field's at times[0]; and how many needed all paths."""
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    h, out = times[1] - times[0], np.empty(Y.shape[0])
    aim = aimed(drift, noise, field, field.mu, times[1], h, parts)
    own = addresses[2], NOWHERE_AT
    step = Step(drift, divergence, noise, field, sten, rule, aim, times[1], h, parts, True, own[0], own[1])
    if threads is None:  # noqa: SIM108 by type, so that the branch not taken is not compiled
        full = back(step, Y, floor, out)
    else:
        full = back_in_blocks(step, Y, floor, out)
    return out, full


@jit
def _factor(addresses, x, t, noise):
    noise_paths.noise_factor_at(function_at(addresses[0]), x, t, noise)


def noise_of(model, G):
    own = Noise(np.asarray(G, float), model.p, not model.constant_diffusion, model.linear)
    return own._replace(along=address_of(ALONG))


def addresses_of(model):
    return tuple([address_of(function) for function in (model.drift_batch, model.divergence_batch, EXPECTED)])


def ends(model, x, t, h, parts, straight, bend):
    noise = noise_of(model, np.zeros((model.dim, 0)))
    return _ends(addresses_of(model), noise, x, t, h, parts, straight, bend)


def carried(model, G, field, times, Y, floor=-np.inf, parts=1, threads=None):
    start_threads()
    rule, sten, noise = paths(np.shape(G)[1], 5), stencils(model.dim), noise_of(model, G)
    times, Y = np.array(times, float), np.ascontiguousarray(Y)
    return _back(addresses_of(model), noise, field, sten, rule, times, parts, Y, floor, threads)


def gaussian_field(mean, cov):
    """A Gaussian on a lattice that is regular where it is whitened."""
    n = len(mean)
    node = disc(n, RADIUS[n])
    A = np.linalg.cholesky(cov) * REACH / RADIUS[n]
    log_p = np.atleast_1d(multivariate_normal(mean, cov).logpdf(mean + node @ A.T))
    return build_field(np.asarray(mean, float), A, node, len(node), log_p, stencils(n))


def near(rng, mean, cov, count=60):
    """States within two standard deviations."""
    z = rng.normal(size=(count, len(mean)))
    z *= 2.0 * rng.random((count, 1)) / np.linalg.norm(z, axis=1, keepdims=True)
    return mean + z @ np.linalg.cholesky(cov).T


# the rules


@pytest.mark.parametrize("m", range(7))
def test_noise_paths_have_the_moments_of_brownian_motion(m):
    """dW: degree five up to three noises, then three; the area beyond the straight path has variance h/12."""
    rule = paths(m, 5)
    w = np.exp(rule.log_weight)
    assert w.sum() == pytest.approx(1.0)
    assert rule.w.shape == (len(w), 2 * m)
    assert np.allclose(w @ rule.w, 0.0)
    dW, bend = rule.w[:, :m], rule.w[:, m:]
    assert np.allclose((dW * w[:, None]).T @ dW, np.eye(m))
    assert np.allclose((dW * w[:, None]).T @ bend, 0.0)
    assert np.allclose(np.einsum("q,qa,qb,qc->abc", w, dW, dW, dW), 0.0)
    if 1 <= m <= 2:
        assert np.allclose((bend * w[:, None]).T @ bend, np.eye(m))
    if 1 <= m <= 3:
        fourth = np.einsum("q,qa,qa,qb,qb->ab", w, *[dW] * 4)
        assert np.allclose(fourth, 1.0 + 2.0 * np.eye(m))


# one path


def integrated(model, x, t, h, straight, bend):
    """End of one displaced path, and the integral of the divergence along it, by scipy."""

    def displaced(u):
        return u * straight + 6.0 * u * (1.0 - u) * bend

    def rates(u, z):
        y = (z[:-1] + displaced(u))[None]
        return h * np.append(model.drift(y, t + u * h)[0], model.divergence(y, t + u * h)[0])

    z = solve_ivp(rates, (0.0, 1.0), np.append(x, 0.0), rtol=1e-11, atol=1e-12).y[:, -1]
    return z[:-1] + displaced(1.0), z[-1]


def swung(h, displaced, parts):
    """Largest error of ends and integrals of a handful of paths."""
    rng = np.random.default_rng(5)
    x, straight, bend = rng.normal(size=(3, 6, 2))
    straight, bend = straight * displaced, bend * displaced
    end, action, alone = ends(SWING, x, 0.4, h, parts, straight, bend)
    assert np.array_equal(end, alone)
    exact = [integrated(SWING, x[i], 0.4, h, straight[i], bend[i]) for i in range(6)]
    return max(np.abs(end - [e[0] for e in exact]).max(), np.abs(action - [e[1] for e in exact]).max())


@pytest.mark.parametrize("displaced", [0.0, 0.7], ids=["straight on", "displaced"])
@pytest.mark.parametrize("h", [0.8, -0.8], ids=["forward", "backward"])
def test_a_path_is_that_of_scipy_to_fourth_order(h, displaced):
    errors = np.array([swung(h, displaced, parts) for parts in (4, 8, 64)])
    assert errors[-1] < 1e-7
    assert errors[0] / errors[1] > 12.0


@pytest.mark.parametrize(("parts", "bridge"), [(1, 1 / 24), (16, 1 / 15)])
def test_a_path_averages_the_drift_over_the_bridge_it_leaves_of_the_noise(parts, bridge):
    """Variance of a Brownian bridge over the step, less that of the bend: 1/6 - 1/10, as the steps see it."""
    curved = sf.SDE.from_expressions(["x", "y"], ["0", "3*x**2 + 0.2*x**3"], [["1"], ["0"]])
    noise, h, blur = noise_of(curved, np.zeros((2, 0))), 0.2, np.array([[0.7, 0.0], [0.7, 0.0]])
    x = np.array([[0.0, 0.0], [0.5, 1.0]])
    end, action = _blurred(addresses_of(curved), noise, x, h, parts, blur)
    without, _ = _blurred(addresses_of(curved), noise, x, h, parts, blur[:0])
    second = 6.0 + 1.2 * x[:, 0]
    assert np.allclose(end[:, 1] - without[:, 1], 0.5 * second * h * 0.7**2 * bridge, rtol=2e-4)
    assert np.array_equal(end[:, 0], without[:, 0])
    assert not action.any()
    cubic = sf.SDE.from_expressions(["x"], ["x**3"], [["1"]])
    _, action = _blurred(
        addresses_of(cubic), noise_of(cubic, np.zeros((1, 0))), np.zeros((1, 1)), h, parts, blur[:1, :1]
    )
    assert action[0] == pytest.approx(3.0 * h * 0.7**2 * bridge, rel=2e-2)


def test_a_path_back_ends_where_it_came_from():
    x, none = np.random.default_rng(0).normal(size=(5, 2)), np.zeros((5, 2))
    there, action, _ = ends(SWING, x, 0.4, 0.8, 64, none, none)
    again, reverse, _ = ends(SWING, there, 1.2, -0.8, 64, none, none)
    assert np.allclose(again, x, atol=1e-7)
    assert np.allclose(reverse, -action, atol=1e-7)


def test_the_integral_of_a_constant_divergence():
    model = sf.LinearSDE(A=[[-0.5, 1.0], [0.0, -0.2]])
    x = np.random.default_rng(1).normal(size=(5, 2))
    assert np.allclose(ends(model, x, 0.0, -3.0, 2, x, x)[1], 2.1)


# the expectation over them


@pytest.mark.parametrize("h", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (2, 2), (3, 1), (3, 3), (4, 4)])
def test_diffusion_of_a_gaussian_is_exact_for_any_step(n, m, h):
    """No drift: cov + h G Gᵀ, from all paths, and also from the one to the middle of the noise."""
    rng = np.random.default_rng(10 * n + m)
    model = sf.LinearSDE(A=np.zeros((n, n)))
    mean, G, root = rng.normal(size=n), rng.normal(size=(n, m)), rng.normal(size=(n, n))
    cov = np.eye(n) + 0.3 * root @ root.T
    exact = multivariate_normal(mean, cov + h * G @ G.T)
    Y = near(rng, mean, exact.cov.reshape(n, n))
    for floor, full in ((-np.inf, len(Y)), (np.inf, 0)):
        found, count = carried(model, G, gaussian_field(mean, cov), (0.0, h), Y, floor)
        assert np.allclose(found, exact.logpdf(Y), rtol=0.0, atol=1e-9)
        assert count == full


DAMPED = sf.LinearSDE(A=[[0.0, 1.0], [-2.0, -0.5]], b=[0.3, -0.1], noise=[[0.2], [1.0]])


def test_a_gaussian_under_a_linear_drift_is_exact_but_for_the_noise_beyond_its_bends():
    """A long step: the paths' ends respond to their noise as scipy says, and what they see is Gaussian."""
    mean, cov, h = np.array([1.0, 0.5]), np.array([[0.5, 0.1], [0.1, 0.3]]), 1.5
    g, origin = np.array([0.2, 1.0]), np.zeros(2)
    foot = integrated(DAMPED, origin, h, -h, origin, origin)[0]
    M = np.stack([integrated(DAMPED, e, h, -h, origin, origin)[0] - foot for e in np.eye(2)], axis=1)
    pushes = (np.sqrt(h) * g, origin), (origin, np.sqrt(h / 12.0) * g)
    B = np.stack([integrated(DAMPED, origin, h, -h, *push)[0] - foot for push in pushes], axis=1)
    Y = near(np.random.default_rng(3), *moved_linear(mean, cov, h))
    expected = multivariate_normal(mean, cov + B @ B.T).logpdf(foot + Y @ M.T) + 0.5 * h  # minus tr A
    found, _ = carried(DAMPED, g[:, None], gaussian_field(mean, cov), (0.0, h), Y, parts=200)
    assert np.allclose(found, expected, rtol=0.0, atol=1e-8)


def moved_linear(mean, cov, h):
    Phi, offset, Qd = DAMPED.discretize(h)
    return Phi @ mean + offset, Phi @ cov @ Phi.T + Qd


def test_what_straight_and_bent_noise_leave_out_is_of_fifth_order():
    """Against the exact transition: what remains is the noise's part that encloses no area on its way."""
    mean, cov = np.array([1.0, 0.5]), np.array([[0.5, 0.1], [0.1, 0.3]])
    field, errors = gaussian_field(mean, cov), []
    for h in (0.2, 0.4):
        exact = moved_linear(mean, cov, h)
        Y = near(np.random.default_rng(3), *exact)
        found, _ = carried(DAMPED, [[0.2], [1.0]], field, (0.0, h), Y, parts=50)
        errors.append(np.abs(found - multivariate_normal(*exact).logpdf(Y)).max())
    assert 2.0**4.5 < errors[1] / errors[0] < 2.0**5.5


def test_without_noise_the_density_is_that_of_the_path_s_foot():
    field, h = gaussian_field(np.array([0.5, 0.0]), 0.2 * np.eye(2)), 0.8
    Y = near(np.random.default_rng(4), np.array([0.5, -0.4]), 0.1 * np.eye(2), 20)
    found, full = carried(SWING, np.zeros((2, 0)), field, (0.4, 0.4 + h), Y, parts=32)
    feet = [integrated(SWING, y, 0.4 + h, -h, np.zeros(2), np.zeros(2)) for y in Y]
    start = multivariate_normal([0.5, 0.0], 0.2 * np.eye(2))
    assert np.allclose(found, [start.logpdf(foot) + action for foot, action in feet], atol=1e-6)
    assert full == 0


def swung_density(Y, **options):
    field = gaussian_field(np.array([0.5, 0.0]), 0.2 * np.eye(2))
    return carried(SWING, [[0.0], [0.7]], field, (0.0, 0.4), Y, parts=2, **options)


def test_one_path_will_do_where_it_finds_a_density_well_below_the_floor():
    """One nat below it: all other states have all paths, as if there were no floor."""
    Y = np.random.default_rng(5).normal(size=(300, 2))
    one, none = swung_density(Y, floor=np.inf)
    all_paths, every = swung_density(Y)
    floor = np.median(one)
    found, full = swung_density(Y, floor=floor)
    high = one > floor - 1.0
    assert (none, every) == (0, len(Y))
    assert full == high.sum()
    assert 0 < full < len(Y)
    assert np.array_equal(found, np.where(high, all_paths, one))


def test_blocks_of_states_have_the_same_bits():
    """Three blocks, in threads or not; and a state's value does not depend on its neighbours."""
    Y = np.random.default_rng(6).normal(size=(700, 2))
    floor = np.median(swung_density(Y)[0])
    found, full = swung_density(Y, floor=floor)
    blocks, count = swung_density(Y, floor=floor, threads=True)
    assert np.array_equal(found, blocks)
    assert full == count
    assert np.array_equal(found[130:411], swung_density(Y[130:411], floor=floor)[0])


def test_the_factor_of_noise_that_changes_with_time():
    """G Gᵀ / 2 = D at that time; where D has a unit diagonal, columns are at right angles, largest first."""
    model = sf.SDE.from_expressions(
        ["x", "y"], ["0", "0"], [["1 + t", "0.5"], ["0.2", "cos(t)"]], [[1.0, 0.3], [0.3, 0.5]]
    )
    noise = noise_of(model, np.full((2, 2), np.nan))
    for t in (0.0, 0.7, 2.0):
        _factor((address_of(model.diffusion_batch),), np.zeros((3, 2)), t, noise)
        assert np.allclose(0.5 * noise.G @ noise.G.T, model.diffusion(np.zeros((1, 2)), t)[0])
        D = model.diffusion(np.zeros((1, 2)), t)[0]
        scaled = noise.G / np.sqrt(np.diag(D))[:, None]
        squares = scaled.T @ scaled
        assert abs(squares[0, 1]) < 1e-12
        assert squares[0, 0] > squares[1, 1]
