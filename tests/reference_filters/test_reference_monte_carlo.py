"""Monte-Carlo reference: closed forms within its own intervals, chunks kept and continued, domains."""

import numpy as np
import pytest
from scipy.stats import norm

import sphfilter as sf
from reference_filters import monte_carlo
from reference_filters._monomials import down_set, moment_name, recentred, sum_monomials
from reference_filters.closed_forms import linear_moments
from reference_filters.monte_carlo import simulate_statistics
from sphfilter.core.monomials import up_to
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.sde import SDE, LinearSDE

A, G, Q = np.array([[0.0, 1.0], [-1.0, -0.4]]), np.array([[0.0], [1.0]]), 0.7
LINEAR = LinearSDE(A, None, G, Q)
#: The same, but stepped; and text, with names of its states.
HIDDEN = SDE(lambda x: (x[1], -x[0] - 0.4 * x[1]), 2, G, Q)
NAMED = SDE.from_expressions(["q", "v"], ["v", "-q - 0.4*v"], [["0"], ["1"]], [[Q]])
START = sf.Gaussian([1.0, -0.5], [[0.3, 0.1], [0.1, 0.5]])
TIMES = [0.0, 0.7, 2.5]
SECOND = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


def exact(t):
    return linear_moments(A, None, Q * G @ G.T, START.mean, START.cov, t)


@pytest.mark.parametrize("model", [LINEAR, HIDDEN])
def test_moments_and_tails_of_a_linear_model(model):
    beyond = {"q > 1.5": lambda X: X[:, 0] > 1.5}
    found = simulate_statistics(
        model, START, TIMES, moments=SECOND, central=[*SECOND[2:], (4, 0), (2, 2)], indicators=beyond,
        n_paths=300_000, rng=1,
    )  # fmt: skip
    expected = []
    for t in TIMES:
        m, P = exact(t)
        raw = P + np.outer(m, m)
        central = [P[0, 0], P[0, 1], P[1, 1], 3 * P[0, 0] ** 2, P[0, 0] * P[1, 1] + 2 * P[0, 1] ** 2]
        tail = norm.sf(1.5, m[0], np.sqrt(P[0, 0]))
        expected.append([*m, raw[0, 0], raw[0, 1], raw[1, 1], *central, tail])
    expected = np.array(expected)
    assert found.group_values.shape == (10, 3, 11) and found.n_paths == 300_000
    Z = found.pivot(expected)
    # Student's t of 9 degrees, 33 numbers: |t| < 6 is |Ẑ| < 2.65
    assert np.abs(Z).max() < 2.65 and np.mean(np.abs(Z) < 1.0) > 0.75
    np.testing.assert_allclose(found.mean, expected, atol=0.02)
    # the variance of a mean of N draws is P / N
    least = [np.sqrt(np.diag(exact(t)[1]) / found.n_paths) for t in TIMES]
    ratio = found.standard_error[:, :2] / least
    assert np.all((ratio > 0.35) & (ratio < 2.0))


def test_intervals_hold_the_exact_value_as_often_as_they_say():
    held = []
    for seed in range(300):
        found = simulate_statistics(
            LINEAR, START, [1.0], moments=SECOND[:2], central=[(2, 0)], n_paths=2000, rng=seed
        )
        m, P = exact(1.0)
        low, high = found.interval(0.9)
        held.append((low <= [*m, P[0, 0]]) & (high >= [*m, P[0, 0]]))
    np.testing.assert_allclose(np.mean(held, axis=0), 0.9, atol=4 * np.sqrt(0.09 / 300))


def test_steps_of_given_length_have_their_bias():
    """Along a path of noise RK4 is exact for a cubic in t; dx = x² dt from 1 blows up at t = 1."""
    model = SDE(lambda x: (x[0] ** 2,), 1, [[0.0]])
    fine, coarse = (
        simulate_statistics(model, [1.0], [0.5], moments=[(1,)], n_paths=20, step=h).mean.item()
        for h in (0.01, 0.25)
    )
    assert fine == pytest.approx(2.0, abs=1e-7)
    assert 1e-4 < abs(coarse - 2.0) < 2e-2


def test_noise_that_depends_on_state_and_time():
    """dx = t x dW: E x² = x₀² exp(t³ / 3)."""
    model = SDE.from_expressions(["x"], ["0"], [["t*x"]])
    found = simulate_statistics(model, [1.2], [0.6, 1.0], moments=[(2,)], n_paths=50_000, tolerance=3e-3)
    assert np.abs(found.pivot(1.44 * np.exp([[0.072], [1 / 3]]))).max() < 2.65


@pytest.mark.parametrize("start", [[1.0, -0.5], [0.0, 0.0]])
def test_a_known_state_and_noise_that_is_zero_at_first(start):
    """dx = v dt, dv = -x dt + t dW: E[(x - x̄)²] = ∫ sin²(t - s) s² ds = t³/6 - t/4 + sin(2 t)/8."""
    model = SDE.from_expressions(["x", "v"], ["v", "-x"], [["0"], ["t"]])
    found = simulate_statistics(model, start, [0.1, 2.0], moments=[(1, 0)], central=[(2, 0)], n_paths=100_000)
    t = np.array([0.1, 2.0])
    expected = [start[0] * np.cos(t) + start[1] * np.sin(t), t**3 / 6 - t / 4 + np.sin(2 * t) / 8]
    assert np.abs(found.pivot(np.transpose(expected))).max() < 2.65


def test_chunks_are_kept_and_continued(tmp_path, monkeypatch):
    monkeypatch.setattr(monte_carlo, "_CHUNK", 500)
    above = {"q > 1": lambda X: X[:, 0] > 1}
    options = {"moments": SECOND, "central": [(2, 0)], "indicators": above, "rng": 3}
    whole = simulate_statistics(HIDDEN, START, TIMES, n_paths=15_000, **options)
    cached = {**options, "cache": tmp_path / "kept"}
    seen = []

    def stop(done, wanted):
        seen.append((done, wanted))
        if len(seen) == 13:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_statistics(HIDDEN, START, TIMES, n_paths=10_000, progress=stop, **cached)
    assert seen[-1] == (6500, 10_000)
    found = simulate_statistics(HIDDEN, START, TIMES, n_paths=15_000, n_threads=2, **cached)
    np.testing.assert_array_equal(found.group_values, whole.group_values)

    def never(*args, **kwargs):
        raise AssertionError("paths that were there have been drawn again")

    monkeypatch.setattr(monte_carlo.PathSums, "over", never)
    fewer = simulate_statistics(HIDDEN, START, TIMES, n_paths=5000, **cached)
    assert fewer.n_paths == 15_000
    np.testing.assert_array_equal(fewer.group_values, whole.group_values)
    assert len(list((tmp_path / "kept").iterdir())) == 1
    stiffer = SDE(lambda x: (x[1], -x[0] - 0.41 * x[1]), 2, G, Q)
    other = {"q > 1.1": above["q > 1"]}
    wider = sf.Gaussian(START.mean, 1.01 * START.cov)
    for arguments, change in (
        ((stiffer, START, TIMES), {}),
        ((HIDDEN, wider, TIMES), {}),
        ((HIDDEN, START, [0.0, 0.7, 2.6]), {}),
        ((HIDDEN, START, TIMES), {"step": 0.1}),
        ((HIDDEN, START, TIMES), {"indicators": other}),
        ((HIDDEN, START, TIMES), {"rng": 4}),
        ((HIDDEN, START, TIMES), {"central": [(0, 2)]}),
    ):
        with pytest.raises(AssertionError, match="drawn again"):
            simulate_statistics(*arguments, n_paths=5000, **{**cached, **change})


def test_groups_are_of_equal_size_and_their_paths_their_own():
    found = simulate_statistics(LINEAR, START, [1.0], moments=[(1, 0)], n_paths=1003, groups=5)
    assert found.n_paths == 1005
    assert len(np.unique(found.group_values)) == 5


def test_an_angle_is_put_between_its_ends():
    """A Brownian angle: E cos θ = e^(-t/2) cos(θ₀ + t)."""
    model = SDE.from_expressions(["a"], ["1"], [["1"]], domain=[("periodic", -np.pi, np.pi)])
    times, circle = np.array([0.0, 1.0, 3.0]), {"cos": lambda X: np.cos(X[:, 0])}
    circle["out"] = lambda X: np.abs(X[:, 0]) > np.pi
    found = simulate_statistics(model, [3.0], times, moments=[(2,)], indicators=circle, n_paths=200_000)
    cosine = found.select("cos")
    expected = np.exp(-times / 2) * np.cos(3.0 + times)
    assert np.abs(cosine.pivot(expected[:, None])[1:]).max() < 2.65
    np.testing.assert_array_equal(found.select("out").mean, 0.0)
    assert cosine.mean[0].item() == pytest.approx(np.cos(3.0))
    assert found.select("E[a^2]").mean[0].item() == pytest.approx(9.0)
    with pytest.raises(ModelError, match="no central moments"):
        simulate_statistics(model, [3.0], times, central=[(2,)], n_paths=100)


def test_a_mirror_gives_back_what_passes_it():
    """Reflected Brownian motion on (0, 1): E cos πx = e^(-π² D t) cos πx₀."""
    model = SDE.from_expressions(["x"], ["0"], [["1"]], [[0.2]], domain=[("reflecting", 0.0, 1.0)])
    found = simulate_statistics(
        model, [0.2], [0.5, 2.0], n_paths=100_000, step=0.05,
        indicators={"cos": lambda X: np.cos(np.pi * X[:, 0]), "out": lambda X: np.abs(X[:, 0] - 0.5) > 0.5},
    )  # fmt: skip
    expected = np.exp(-(np.pi**2) * 0.1 * np.array([0.5, 2.0])) * np.cos(0.2 * np.pi)
    assert np.abs(found.pivot(np.column_stack([expected, [0.0, 0.0]]))).max() < 2.65
    walled = SDE.from_expressions(["x"], ["0"], [["1"]], domain=[("bounded", -1.0, 1.0)])
    with pytest.raises(PropagationError, match="left the domain"):
        simulate_statistics(walled, [0.2], [2.0], moments=[(1,)], n_paths=100)


class Two:
    """A start of one's own: two states."""

    def draw(self, rng, n):
        return np.column_stack([rng.choice([-1.0, 1.0], n), np.zeros(n)])


@pytest.mark.parametrize(
    ("start", "mean", "cov"),
    [
        (START, START.mean, START.cov),
        (sf.Uniform([[0.0, 3.0], [-1.0, 0.0]]), [1.5, -0.5], np.diag([9 / 12, 1 / 12])),
        ([0.3, -2.0], [0.3, -2.0], np.zeros((2, 2))),
        (Two(), [0.0, 0.0], np.diag([1.0, 0.0])),
    ],
)
def test_starts(start, mean, cov):
    found = simulate_statistics(LINEAR, start, [0.0], moments=SECOND[:2], central=SECOND[2:], n_paths=100_000)
    expected = [*mean, cov[0, 0], cov[0, 1], cov[1, 1]]
    np.testing.assert_allclose(found.mean[0], expected, atol=4.5 * 1.5 / np.sqrt(100_000))


def test_a_start_is_cut_off_at_walls():
    model = SDE.from_expressions(["x"], ["0"], [["1"]], domain=[("reflecting", 0.0, None)])
    found = simulate_statistics(
        model, sf.Gaussian([0.0], [[1.0]]), [0.0], moments=[(1,), (2,)], n_paths=50_000
    )
    assert np.abs(found.pivot([[np.sqrt(2 / np.pi), 1.0]])).max() < 2.65
    with pytest.raises(ModelError, match="hardly ever draws"):
        simulate_statistics(model, [-1.0], [1.0], moments=[(1,)], n_paths=100)


def test_sums_about_one_centre_tell_moments_about_another():
    x = np.random.default_rng(0).standard_normal((1000, 3)) * [1.0, 2.0, 0.1] + [3.0, 0.0, -50.0]
    wanted = [(0, 0, 2), (2, 1, 1), (0, 6, 0), (1, 0, 3)]
    powers = down_set(wanted, 3)
    c0, c1 = np.array([2.9, 0.2, -50.1]), np.array([3.1, 0.0, -49.9])
    found = recentred(sum_monomials(x, c0, powers) / len(x), powers, c0 - c1, wanted)
    np.testing.assert_allclose(found, [np.prod((x - c1) ** a, axis=1).mean() for a in wanted], rtol=1e-9)
    assert len(up_to(4, 3)) == 35 and set(down_set([(4, 0, 0)], 3)) < set(up_to(4, 3))
    assert moment_name((2, 1, 0), "abc") == "E[a^2 b]"


def test_central_moments_far_from_the_origin_keep_their_digits():
    model = LinearSDE([[0.0]], [1e6], [[1.0]])
    found = simulate_statistics(model, sf.Gaussian([1e7], [[4.0]]), [3.0], central=[(2,)], n_paths=100_000)
    assert np.abs(found.pivot([[7.0]])).max() < 2.65


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"moments": [(1,)]}, "give 2 whole numbers"),
        ({"moments": [(1, -1)]}, "whole numbers >= 0"),
        ({"moments": [(0.5, 1)]}, "whole numbers"),
        ({"moments": []}, "nothing is asked"),
        ({"t0": 1.0}, "before the start"),
        ({"indicators": {"all": lambda X: True}}, "indicator 'all'.*shape"),
        ({"start": [1.0]}, "start has shape"),
        ({"n_paths": 3}, "n_paths"),
        ({"step": 0.0}, "step"),
    ],
)
def test_what_does_not_fit_is_said(change, words):
    options = {"start": START, "times": [0.0, 1.0], "moments": [(1, 0)], "n_paths": 100, **change}
    with pytest.raises(ModelError, match=words):
        simulate_statistics(LINEAR, **options)


def test_names_follow_the_states():
    found = simulate_statistics(NAMED, START, [0.0], moments=[(1, 0)], central=[(2, 1)], n_paths=100)
    assert found.names == ("E[q]", "C[q^2 v]")
    with pytest.raises(ModelError, match=r"did you mean 'E\[q\]'"):
        found.select("E[p]")
