"""The compiled core of clouds: curve, noise, steps, linearised blocks, guide, against closed forms."""

import numpy as np
import pytest
from scipy import stats

import sphfilter as sf
from sphfilter.core.cloud.blocks import blocks_of, steered
from sphfilter.core.cloud.curve import along_curve, places
from sphfilter.core.cloud.guide import Ahead, look_ahead
from sphfilter.core.cloud.linearise import linearise, lower_and_rows, widths
from sphfilter.core.cloud.move import move
from sphfilter.core.cloud.noise import ADDITIVE, LANES, even_normals, fill_noise, rotation
from sphfilter.core.cloud.pace import moved_twice
from sphfilter.core.cloud.weights import compared, systematic
from sphfilter.density.moments import columns
from sphfilter.density.passage import leg_of, points_of_sample
from sphfilter.density.points import Points
from sphfilter.density.quasi_random import net

WELLS = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[1.6]])
KEY = np.uint64(7)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_the_curve_goes_from_each_cell_to_a_neighbour(n):
    """It passes every cell once."""
    table, bits = places(n)
    cells = np.stack(np.meshgrid(*[np.arange(2**bits)] * n, indexing="ij"), axis=-1).reshape(-1, n)
    order = np.argsort(table)
    assert len(np.unique(table)) == len(cells)
    assert np.abs(np.diff(cells[order], axis=0)).sum(axis=1).max() == 1


def test_points_in_order_have_near_neighbours_in_any_units():
    rng = np.random.default_rng(1)
    x, w = rng.standard_normal((4000, 3)), np.full(4000, 1 / 4000)
    order = along_curve(columns(x), w, *places(3))
    assert sorted(order) == list(range(4000))
    assert np.linalg.norm(np.diff(x[order], axis=0), axis=1).mean() < 0.45
    np.testing.assert_array_equal(order, along_curve(columns(x * [1e-8, 1.0, 1e9]), w, *places(3)))
    flat = x * [1.0, 0.0, 1.0]
    assert sorted(along_curve(columns(flat), w, *places(3))) == list(range(4000))


def test_noise_has_a_normals_moments_up_to_the_fifth_and_streams_of_its_own():
    state, Z = np.empty(LANES, np.uint64), np.empty((3, 4000, LANES))
    fill_noise(KEY, np.uint64(0), ADDITIVE, False, state, Z)
    for row in Z[:2]:
        moments = [np.mean(row**k) for k in range(1, 6)]
        np.testing.assert_allclose(moments, [0, 1, 0, 3, 0], atol=0.06)
    assert set(np.unique(Z[2])) == {-1.0, 1.0} and abs(Z[2].mean()) < 0.01
    other = np.empty_like(Z)
    fill_noise(KEY, np.uint64(1), ADDITIVE, False, state, other)
    flat = np.concatenate([Z, other]).reshape(6, -1)
    assert np.abs(np.corrcoef(flat) - np.eye(6)).max() < 0.01


def test_nets_are_standard_normal_and_stay_so_when_they_are_turned():
    for count, n in ((256, 1), (1024, 3), (1000, 6)):
        z = even_normals(net(count, n).T, KEY).T
        np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(z.T @ z / count, np.eye(n), atol=1e-9)
        assert stats.kstest(z[:, 0], "norm").statistic < 0.04
    Q = rotation(KEY, 5)
    np.testing.assert_allclose(Q @ Q.T, np.eye(5), atol=1e-12)


def moments_after(model, steps, x, t1, seed=3):
    """Mean and second moments of many points after an interval in equal steps."""
    leg, N = leg_of(model, 0.0, t1, steps), len(x)
    x = columns(x).copy()
    V = np.zeros((1, model.dim, steps * model.n_noise))  # nothing is steered
    move(leg, x, np.zeros_like(x), V, np.zeros(N, np.int64), np.uint64(seed), 0, -(-N // LANES))
    return np.concatenate([x.mean(axis=1), (x**2).mean(axis=1)])


def test_steps_beside_additive_noise_are_of_weak_order_three():
    """An oscillator of one frequency, driven: exact by its transition."""
    model = sf.SDE.from_expressions(["x", "v"], ["v", "-4*x - 0.5*v"], [["0"], ["1"]], [[1.0]])
    F, _, Q = sf.LinearSDE([[0.0, 1.0], [-4.0, -0.5]], noise=[[0.0], [1.0]]).discretize(2.0)
    start = np.array([1.5, 0.0])
    exact = np.concatenate([F @ start, (F @ start) ** 2 + np.diag(Q)])
    x = np.tile(start, (2**17, 1))
    off = [np.abs(moments_after(model, k, x, 2.0) - exact).max() for k in (4, 8)]
    assert off[1] < off[0] / 5.6 and off[1] < 0.02


def test_steps_of_noise_that_depends_on_the_state_are_of_weak_order_two():
    """Two geometric motions with noises that do not commute with a drift that couples them."""
    model = sf.SDE.from_expressions(
        ["x", "y"], ["-x + 0.5*y", "-y"], [["0.5*x", "0"], ["0.3*y", "0.4*y"]], interpretation="stratonovich"
    )
    x = np.tile([1.0, 1.0], (2**16, 1))
    fine = moments_after(model, 64, x, 2.0)
    off = [np.abs(moments_after(model, k, x, 2.0) - fine).max() for k in (2, 4)]
    assert off[1] < 0.01 and off[1] < off[0] / 2.5


def test_stiff_drifts_are_followed_in_parts():
    model = sf.SDE.from_expressions(["x"], ["-1e4*(x - 1)"], [["1"]], [[1e-3]])
    x = np.linspace(-50.0, 50.0, 200)[None].copy()
    leg = leg_of(model, 0.0, 1.0, 4, stiff=True)
    V = np.zeros((1, 1, 4))
    move(leg, x, np.zeros_like(x), V, np.zeros(200, np.int64), KEY, 0, 2)
    np.testing.assert_allclose(x, 1.0, atol=0.02)


@pytest.mark.parametrize("rate", [6.0, 12.7, 40.0])
def test_steps_see_variances_that_a_stiff_drift_damps(rate):
    """Beside two wells an Ornstein-Uhlenbeck process, whose variance is known; its mean is right anyway."""
    model = sf.SDE.from_expressions(["x", "s"], [f"-{rate}*x", "0.45*(s - s**3)"], [["0.1"], ["0.15"]])
    flt = sf.SPHFilter(model, sf.GaussianMeasurement([[0.0, 1.0]], [[1.0]]), x0=[0.0, 1.5], P0=np.eye(2))
    info = flt.predict(3.0)
    assert info.scheme == "cloud"
    assert flt.P[0, 0] == pytest.approx(0.01 / (2.0 * rate), rel=3.0 * max(info.variance_error, 0.01))


def test_half_steps_go_along_the_same_noise():
    """Without drift the ends of both are the same to rounding."""
    free = sf.SDE.from_expressions(["x", "s"], ["0*x", "x"], [["1"], ["0"]], [[0.5]])
    coarse, fine = moved_twice(leg_of(free, 0.0, 2.0, 3), leg_of(free, 0.0, 2.0, 6), np.zeros((64, 2)), KEY)
    np.testing.assert_allclose(coarse[:, 0], fine[:, 0], atol=1e-12)
    assert np.std(coarse[:, 1] - fine[:, 1]) < 0.1 * np.std(fine[:, 1])


def test_blocks_are_linearised_as_differences_of_their_flow_say():
    leg, c = leg_of(WELLS, 0.0, 1.0, 40), np.array([[1.0, 0.5], [-2.0, 1.0]])
    end = c.copy()
    flow, B = linearise(leg, end)
    for a in range(2):
        ends = []
        for s in (1e-4, -1e-4):
            moved = c + s * np.eye(2)[a]
            linearise(leg, moved)
            ends.append(moved)
        np.testing.assert_allclose(flow[:, :, a], (ends[0] - ends[1]) / 2e-4, atol=2e-3)
    L, V = lower_and_rows(B)
    np.testing.assert_allclose(L @ V, B, atol=1e-12)
    np.testing.assert_allclose(V @ np.swapaxes(V, 1, 2), np.tile(np.eye(2), (2, 1, 1)), atol=1e-12)
    L, V = lower_and_rows(np.tile(np.array([[1.0, 2.0], [2.0, 4.0]]), (1, 1, 1)))  # of rank one
    assert L[0, 1, 1] == 0.0 and not V[0, 1].any()


def test_what_moves_the_end_moves_it_as_linearised():
    """Of a linear flow: ends are those of the flow plus L u, and what u leaves free is small."""
    model = sf.SDE.from_expressions(["x", "v"], ["v", "-x"], [["0"], ["1"]], [[0.3]])
    N, steps = 512, 12
    x, leg = np.tile([[1.0], [0.0]], (1, N)), leg_of(model, 0.0, 1.0, steps)
    end = np.array([[1.0, 0.0]])
    _, B = linearise(leg, end)
    L, V = lower_and_rows(B)
    u = np.random.default_rng(2).standard_normal((2, N))
    move(leg, x, u, V, np.zeros(N, np.int64), KEY, 0, -(-N // LANES))
    rest = x - end.T - L[0] @ u
    assert rest.std(axis=1).max() < 0.1 * L[0].diagonal().min()


def test_whatever_is_steered_the_law_of_the_noise_stays():
    rows = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 3)))[0].T[None]
    U = np.random.default_rng(2).standard_normal((8, 40_000))
    u = np.random.default_rng(3).standard_normal((3, 40_000))
    steered(np.ascontiguousarray(rows), np.zeros(40_000, np.int64), u, U)
    np.testing.assert_allclose(rows[0] @ U, u, atol=1e-12)
    np.testing.assert_allclose(U @ U.T / 40_000, np.eye(8), atol=0.03)


def test_the_guide_is_exact_where_everything_is_linear():
    """Every weight of the second pass is the evidence of a Gaussian, over how much oftener it was drawn."""
    rng, N = np.random.default_rng(4), 256
    m, w, u = rng.standard_normal((1, N)), np.full(N, 1.0 / N), rng.standard_normal((1, N))
    HL, R, z = np.array([[[0.8]]]), np.array([[[0.3]]]), 1.4
    block = np.zeros(N, np.int64)
    ahead = Ahead(z - m, m, np.array([[[0.8]]]), HL, R)
    ancestor, new, log_ratio = look_ahead(ahead, u, w, block, net(N, 1).T, 7)
    log_l = stats.norm.logpdf(z - m[:, ancestor] - 0.8 * new, scale=np.sqrt(0.3))[0]
    log_w = log_l - log_ratio[N:]
    exact = np.log(np.mean(stats.norm.pdf(z, m, np.sqrt(0.64 + 0.3))))
    a = stats.norm.pdf(z, m[0], np.sqrt(0.64 + 0.3))
    a, end = a / a.sum(), m[0] + 0.64 / (0.64 + 0.3) * (z - m[0])
    far = a * np.abs(end - a @ end) / np.sqrt(a @ (end - a @ end) ** 2)
    often = a + far / (1.0 + N * far)
    np.testing.assert_allclose(log_w, exact + np.log(a * often.sum() / often)[ancestor], atol=1e-6)
    np.testing.assert_allclose(np.bincount(ancestor, minlength=N), N * often / often.sum(), atol=1.0)
    assert np.all(np.diff(ancestor) >= 0)


def test_strata_copy_each_point_as_often_as_its_weight_says():
    w = np.array([0.0, 0.1, 0.0, 0.6, 0.3, 0.0])
    for shift in (0.0, 0.3, 0.999):
        counts = np.bincount(systematic(w, 1000, shift), minlength=6)
        np.testing.assert_allclose(counts, 1000 * w, atol=1.0)
        assert not counts[w == 0.0].any()


def test_two_clouds_are_compared_whatever_the_units():
    P, off = np.array([[2.0, 0.3], [0.3, 1.0]]), np.sqrt([0.02, 0.0])
    first, second, most = compared(np.zeros(2), P, off, 1.2 * P)
    assert first == pytest.approx(0.005) and second == most == pytest.approx(0.04)
    assert compared(np.zeros(2), P, np.zeros(2), P + np.diag([0.0, 0.5]))[1:] == pytest.approx((0.125, 0.25))
    D = np.diag([1e-9, 1e6])
    again = compared(np.zeros(2), D @ P @ D, D @ off, 1.2 * D @ P @ D)
    np.testing.assert_allclose(again, (first, second, most), rtol=1e-6)


def test_what_readings_leave_keeps_its_bend_where_it_begins_again():
    def bend(x):
        off = x - x.mean(axis=0)
        return np.mean(off[:, 0] ** 2 * off[:, 1])

    rng, kept, each = np.random.default_rng(3), [], np.arange(4096)[None]
    for draw in range(3):
        x = rng.standard_normal((4096, 6))
        x[:, 1] += x[:, 0] ** 2
        points = Points(x, np.full(4096, 1.0 / 4096), lineage=each)
        for k in range(12):
            points = points_of_sample(points, 4096, 100 * draw + k)._replace(path=None, lineage=each)
        kept.append(bend(points.x) / bend(x))
    assert np.mean(kept) == pytest.approx(1.0, abs=0.06)  # .79 with Gaussians as wide as points are apart


def test_no_point_is_strewn_between_two_modes():
    """The block in which one ends and the other begins is as wide as both are apart: its points are not."""
    x = np.random.default_rng(4).standard_normal((512, 2))
    x[::3, 0] += 100.0
    for lineage in (None, np.arange(512)[None], np.repeat(np.arange(32), 16)[None]):
        points = points_of_sample(Points(x, np.full(512, 1.0 / 512), lineage=lineage), 512, 1)
        assert np.all(
            np.minimum(abs(points.x[:, 0]), abs(points.x[:, 0] - 100.0)) < 6.0
        )  # 18 as wide as blocks
        np.testing.assert_allclose(np.cov(points.x.T), np.cov(x.T), rtol=0.02, atol=0.3)


def test_copies_of_few_points_stand_for_more_than_their_distance():
    rng = np.random.default_rng(5)
    few = rng.standard_normal((2, 16))
    lineage = np.repeat(np.arange(16), 16)
    alone = widths(rng.standard_normal((2, 256)), np.arange(256), 1.0)
    copies = widths(few[:, lineage] + 1e-6 * rng.standard_normal((2, 256)), lineage, 1.0)
    apart = widths(few[:, lineage] + 5.0 * rng.standard_normal((2, 256)), lineage, 1.0)
    wide = widths(rng.standard_normal((4, 256)), np.arange(256), 0.5)
    np.testing.assert_allclose(wide, 64**-0.25)
    np.testing.assert_allclose(alone, 64**-0.5)
    assert np.all(copies > 0.4) and np.all(apart < 0.2)
    assert len(blocks_of(256)) == 256
