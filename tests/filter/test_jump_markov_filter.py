"""The filter of a model that switches: its densities against grids, Bayes factors and filters of one mode."""

import pickle
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from density_cases import drifting, moving
from scipy.linalg import expm

import sphfilter as sf
from reference_filters.jump_grid import JumpGridFilter, unsplit_jump_filter
from sphfilter.density.memory import Memory
from sphfilter.density.modes import ModeDensities
from sphfilter.prediction.mixing import Allowed, Part, mixed
from sphfilter.prediction.switching import predict_modes

SMOOTH = sf.FilterConfig(density_error=0.01)  # as modes are carried
CLOUDS = sf.FilterConfig(scheme=sf.CloudScheme(n_points=20_000))
READING = sf.GaussianMeasurement([[1.0]], [[0.04]])


def wells():
    """Three modes, two of them nonlinear."""
    double = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.3]])
    middle = sf.SDE.from_expressions(["x"], ["-2*x"], [["1"]], [[0.6]])
    right = sf.SDE.from_expressions(["x"], ["1.5*x - x**3 + 0.5"], [["1"]], [[0.6]])
    rates = [[-0.3, 0.2, 0.1], [0.5, -0.6, 0.1], [0.2, 0.2, -0.4]]
    return sf.JumpMarkovModel({"double": double, "middle": middle, "right": right}, rates)


def course(turn=0.4):
    """Cross-track and heading of a target of unit speed that goes straight, or turns to one side."""

    def mode(rate):
        drift = ["sin(theta)", "w"]
        return sf.SDE.from_expressions(["y", "theta"], drift, [["0"], ["1"]], [[0.01]], {"w": rate})

    modes = {"straight": mode(0.0), "left": mode(turn), "right": mode(-turn)}
    return sf.JumpMarkovModel(modes, [[-0.1, 0.05, 0.05], [0.25, -0.25, 0.0], [0.25, 0.0, -0.25]])


def record(model, T, seed=3, dt=1.0):
    times = dt * np.arange(1, T + 1)
    drawn = sf.simulate_modes(model, READING, np.zeros(model.dim), np.r_[0.0, times], rng=seed)
    return times, drawn.z[1:], drawn.truth[1:]


def run(model, times, z, **options):
    return sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]], **options).run(times, z)


@pytest.mark.parametrize(
    ("model", "box"), [(moving(), (-6.0, 20.0)), (wells(), (-6.0, 6.0))], ids=["linear", "nonlinear"]
)
def test_mode_probabilities_of_a_whole_record_are_those_of_the_grid(model, box):
    times, z, _ = record(model, 20)
    grid = unsplit_jump_filter(model, READING, 0.0, 0.1, times, z, box=box, size=1001)
    found = run(model, times, z)
    assert np.abs(found.mode_probabilities - grid[:, 3:]).max() < 0.01
    assert np.abs((found.x[:, 0] - grid[:, 0]) / np.sqrt(grid[:, 1])).max() < 0.03
    assert np.abs(found.P[:, 0, 0] / grid[:, 1] - 1.0).max() < 0.03
    assert abs(found.log_evidence.sum() - grid[-1, 2]) < 0.05
    assert found.names == model.names


def test_a_target_that_turns_now_and_then_is_followed_as_by_a_grid_of_two_states():
    model, sensor, P0 = course(), sf.GaussianMeasurement([[1.0, 0.0]], [[0.04]]), 0.04 * np.eye(2)
    times = np.arange(1.0, 9.0)
    drawn = sf.simulate_modes(model, sensor, [0.0, 0.0], np.r_[0.0, times], rng=6, mode="straight")
    low, high = drawn.truth.min(axis=0) - 4.0, drawn.truth.max(axis=0) + 4.0
    box = np.transpose([low, high])
    coarse, grid = (
        JumpGridFilter(model, sensor, [0.0, 0.0], P0, box=box, size=size, step=step)
        for size, step in ((96, 0.125), (128, 0.0625))
    )
    flt = sf.JumpMarkovFilter(model, sensor, [0.0, 0.0], P0)
    off, told = [], []
    assert len(set(drawn.modes)) > 1
    for t, z in zip(times, drawn.z[1:], strict=True):
        for each in (coarse, grid, flt):
            each.predict(t=t)
            info = each.update(z)
        told.append(info.evidence_error)
        assert np.abs(coarse.mode_probabilities - grid.mode_probabilities).max() < 0.001
        assert np.abs(flt.mode_probabilities - grid.mode_probabilities).max() < info.error < 0.03
        off.append((flt.x - grid.x) / np.sqrt(np.diag(grid.P)))
    assert all(density.read_out == "cloud" for density in flt.densities.values())
    assert np.sqrt(np.mean(np.square(off))) < 0.01  # as asked
    assert np.abs(off).max() < 0.03
    assert abs(flt.log_evidence - grid.log_evidence) < np.linalg.norm(told) < 0.07


def test_modes_that_go_as_clouds_hang_on_neither_their_order_nor_a_file_and_equal_ones_are_one(tmp_path):
    sensor, P0, w = sf.GaussianMeasurement([[1.0, 0.0]], [[0.04]]), 0.04 * np.eye(2), {"left": 1.0}
    filters = []
    for names in (("straight", "left", "right"), ("right", "straight", "left")):
        order = [("straight", "left", "right").index(name) for name in names]
        modes = {name: course().modes[name] for name in names}
        model = sf.JumpMarkovModel(modes, course().rates[np.ix_(order, order)])
        filters.append(sf.JumpMarkovFilter(model, sensor, [0.0, 0.0], P0, mode_probabilities=w))
    left = course().modes["left"]
    model = sf.JumpMarkovModel({"one": left, "other": left}, [[-0.5, 0.5], [0.2, -0.2]])
    filters.append(sf.JumpMarkovFilter(model, sensor, [0.0, 0.0], P0))
    fine = sf.FilterConfig(target_error=1e-3)
    filters.append(sf.SPHFilter(left, sensor, [0.0, 0.0], P0, config=fine))
    first, turned, equal, alone = filters
    for z in (0.1, 0.4, 1.0):
        told = []
        for flt in filters:
            flt.predict(1.0)
            told.append(flt.update([z]).error)
        for found, right, error in ((turned, first, np.hypot(*told[:2])), (equal, alone, told[2])):
            assert np.abs((found.x - right.x) / np.sqrt(np.diag(right.P))).max() < 3.0 * error
        assert equal.mode_probabilities == pytest.approx(model.stationary, abs=0.01)
    first.save(tmp_path / "modes.npz")
    again = sf.JumpMarkovFilter.load(tmp_path / "modes.npz", first.model, sensor)
    for flt in (first, again):
        flt.predict(0.7)
        flt.update([1.2])
    assert first.x.tobytes() + first.P.tobytes() == again.x.tobytes() + again.P.tobytes()


@pytest.mark.parametrize(
    ("rates", "velocity", "falls"),
    [([[-0.6, 0.6], [0.9, -0.9]], 1.0, 3.0), ([[-0.01, 0.01], [0.02, -0.02]], 1.0, 3.0),
     ([[-0.1, 0.1], [0.1, -0.1]], 6.0, 1.5)],
    ids=["many jumps", "few", "far"],
)  # fmt: skip
def test_the_splitting_is_of_second_order_at_least_and_its_error_is_seen(rates, velocity, falls):
    model = sf.JumpMarkovModel({"rest": drifting(0.0), "moving": drifting(velocity)}, rates)
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]))
    modes = ModeDensities(np.log([0.8, 0.2]), [start, start])
    config = sf.FilterConfig(target_error=1e-5)
    X = np.linspace(-3.0, 3.0 + velocity, 200)[:, None]

    def density(steps):
        moved, info = predict_modes(modes, model, 1.0, config, "auto", steps)
        return np.exp(moved.logpdf(X)), info.splitting_error

    exact = density(32)[0]
    found = [density(steps) for steps in (1, 2, 4)]
    off = np.array([np.abs(p - exact).sum() * (X[1, 0] - X[0, 0]) for p, _ in found])
    assert np.all(off[:-1] / off[1:] > falls)
    said = np.array([error for _, error in found])
    counts = off > 1e-5
    assert np.all(said[counts] > off[counts] / 3.0)
    assert np.all(said[counts] < 3.0 * off[counts])


def exactly(model, P0, w, t, X):
    """Densities (M, N) of the modes with their probabilities, by the characteristic function of each."""
    b, g = (np.array([f(mode) for mode in model.modes.values()]) for f in (_drift, _noise))
    k = np.linspace(-80.0, 80.0, 4001)
    carried = expm(
        t * (np.eye(len(b)) * (1j * np.outer(k, b) - 0.5 * np.outer(k**2, g))[:, None] + model.rates.T)
    )
    phi = np.einsum("kij,j,k->ki", carried, w, np.exp(-0.5 * k**2 * P0))
    return (np.exp(-1j * np.outer(X, k)) @ phi).real.T * (k[1] - k[0]) / (2.0 * np.pi)


def _drift(mode):
    return mode.drift(np.zeros((1, 1)), 0.0)[0, 0]


def _noise(mode):
    return 2.0 * mode.diffusion(np.zeros((1, 1)), 0.0)[0, 0, 0]


@pytest.mark.parametrize(
    ("drifts", "noises", "rate"),
    [
        ((0.0, 0.0), (0.1, 1.5), 3.0),
        ((0.0, 0.0), (0.1, 1.5), 100.0),
        ((-3.0, 3.0), (0.5, 0.5), 30.0),
        ((-1.0, 1.0), (0.1, 1.0), 2.0),
    ],
)
def test_modes_of_different_noise_are_carried_by_few_pieces_and_are_exact(drifts, noises, rate):
    modes = {name: drifting(*of) for name, of in zip("ab", zip(drifts, noises, strict=True), strict=True)}
    model = sf.JumpMarkovModel(modes, [[-rate, rate], [2.0 * rate, -2.0 * rate]])
    flt = sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]])
    start = flt.mode_probabilities
    info = flt.predict(1.0)
    X = flt.x + np.linspace(-6.0, 6.0, 601) * np.sqrt(flt.P[0, 0])
    parts = zip(flt.mode_probabilities, flt.densities.values(), strict=True)
    found = np.array([w * p.pdf(X[:, None]) for w, p in parts])
    off = np.abs(found - exactly(model, 0.1, start, 1.0, X)).sum() * (X[1] - X[0])
    assert off < 0.01
    assert info.status == "ok"
    assert sum(len(p.pieces.w) for p in flt.densities.values()) < 100


@pytest.mark.parametrize("rate", [0.01, 1.0])
def test_mergers_of_gaussians_do_not_widen_the_tails_for_a_reading_far_out(rate):
    model = moving([[-rate, rate], [rate, -rate]])
    for z in (1.0, 3.0, 3.5, 4.0, -2.5):
        flt = sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]])
        flt.predict(1.0)
        info = flt.update(z)
        parts = exactly(model, 0.1 + 0.04, model.stationary, 1.0, np.array([z]))[:, 0]  # with the noise of z
        assert info.log_evidence == pytest.approx(np.log(parts.sum()), abs=0.02)
        assert abs(info.log_evidence - np.log(parts.sum())) < info.evidence_error + 0.01
        assert (sf.Code.REPEATED in info.code) == (z != 1.0)
        assert info.evidence_error < 0.05


@pytest.mark.parametrize("target", [0.01, 0.1])
def test_a_reading_may_be_explained_by_a_mode_that_was_left_again(target):
    """Of 1e-4 that go there half are back, as far off: a reading at ten standard deviations is of them."""
    rates = [[-1e-4, 1e-4], [2.0, -2.0]]
    model = sf.JumpMarkovModel({"quiet": drifting(0.0, 0.01), "loud": drifting(0.0, 9.0)}, rates)
    config, w = sf.FilterConfig(target_error=target), np.array([1.0, 0.0])
    flt, z = sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]], mode_probabilities=w, config=config), 2.5
    info = [flt.predict(1.0), flt.update([z])][1]
    parts = exactly(model, 0.1 + 0.04, w, 1.0, np.array([z]))[:, 0]
    off = np.abs(flt.mode_probabilities - parts / parts.sum()).max()
    assert off < 3.0 * info.splitting_error + 3.0 * flt._state.density.in_doubt.max()
    assert abs(info.log_evidence - np.log(parts.sum())) < 3.0 * info.evidence_error
    assert off < 3.0 * target or info.flagged
    assert target > 0.01 or off < 0.03
    # what is in doubt of the modes is so of the density that they are mixed to
    assert flt.predict(1.0).error > 0.3 * off


def test_a_light_peak_far_off_keeps_its_part_of_the_variance():
    back = sf.SDE.from_expressions(["x"], ["-x/2 - 3/2"], [["1"]], [[0.5]])
    modes = {"there": drifting(1.5, 0.5), "rest": drifting(0.0, 0.4), "back": back}
    model = sf.JumpMarkovModel(modes, [[-3.0, 2.5, 0.5], [0.5, -4.5, 4.0], [0.5, 4.0, -4.5]])
    square = sf.GaussianMeasurement.from_expressions(["x"], ["x**2"], [[0.1]])
    flt = sf.JumpMarkovFilter(model, square, [-0.7], [[0.4]])
    grid = JumpGridFilter(model, square, [-0.7], [[0.4]], box=[[-10.0, 7.0]], size=1024, step=1 / 48)
    for t, z in enumerate((2.9, 8.1, 7.4, 7.4, 11.0, 12.2), 1):
        for each in (flt, grid):
            each.predict(t=float(t))
            each.update(z)
        assert np.sqrt(flt.P[0, 0] / grid.P[0, 0]) == pytest.approx(1.0, abs=0.02)
    other = flt.density.probability(lambda X: X[:, 0] > 0.0)
    assert 0.0 < other < 1e-3 < other * 7.0**2 / flt.P[0, 0]  # little, which counts


def test_a_reading_that_few_steps_have_put_little_at_asks_for_more():
    model, sharp = moving([[-0.01, 0.01], [0.01, -0.01]]), sf.GaussianMeasurement([[1.0]], [[4e-4]])
    flt = sf.JumpMarkovFilter(model, sharp, [0.0], [[0.01]], mode_probabilities={"rest": 1.0})
    few = flt.predict(1.0)
    info = flt.update([0.7])
    assert few.n_substeps < 4
    assert sf.Code.REPEATED in info.code
    told = {"mode_probabilities": [1.0, 0.0], "box": (-2.0, 3.0), "size": 1001}
    grid = unsplit_jump_filter(model, sharp, 0.0, 0.01, [1.0], [[0.7]], **told)[0]
    assert np.abs(flt.mode_probabilities - grid[3:]).max() < 0.01
    assert abs(flt.x[0] - grid[0]) < 0.03 * np.sqrt(grid[1])
    assert flt.log_evidence == pytest.approx(grid[2], abs=0.03)


def test_steps_follow_the_target_error():
    model = moving()
    fine, coarse = (
        sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]], config=sf.FilterConfig(target_error=target))
        for target in (0.003, 0.03)
    )
    few, many = coarse.predict(1.0), fine.predict(1.0)
    assert few.n_substeps < many.n_substeps
    assert many.splitting_error < few.splitting_error < 0.03
    assert few.status == many.status == "ok"


def test_modes_without_jumps_are_filters_of_their_own():
    model = wells()
    still = sf.JumpMarkovModel(model.modes, np.zeros((3, 3)))
    times, z, _ = record(model, 6)
    start = np.array([0.5, 0.3, 0.2])
    found = run(still, times, z, mode_probabilities=start)
    filters = (sf.SPHFilter(mode, READING, [0.0], [[0.1]], config=SMOOTH) for mode in model.modes.values())
    alone = [flt.run(times, z) for flt in filters]
    log_w = np.log(start) + np.cumsum([own.log_evidence for own in alone], axis=1).T
    total = np.logaddexp.reduce(log_w, axis=1)
    w = np.exp(log_w - total[:, None])
    np.testing.assert_allclose(found.mode_probabilities, w, atol=1e-3)
    np.testing.assert_allclose(found.log_evidence.cumsum(), total, atol=2e-3)
    np.testing.assert_allclose(found.x, np.einsum("tk,ktn->tn", w, [own.x for own in alone]), atol=2e-3)


def test_equal_modes_are_one():
    well = wells().modes["double"]
    model = sf.JumpMarkovModel({"one": well, "other": well}, [[-0.5, 0.5], [0.2, -0.2]])
    times, z, _ = record(model, 6)
    fine = sf.FilterConfig(target_error=1e-3, density_error=1e-3)
    found = run(model, times, z, config=fine)
    alone = sf.SPHFilter(well, READING, [0.0], [[0.1]], config=fine).run(times, z)
    assert np.abs((found.x - alone.x) / np.sqrt(alone.P[:, 0])).max() < 0.01  # as asked
    np.testing.assert_allclose(found.P, alone.P, rtol=0.02)
    np.testing.assert_allclose(found.log_evidence, alone.log_evidence, atol=0.01)
    np.testing.assert_allclose(found.mode_probabilities, np.tile(model.stationary, (6, 1)), atol=1e-12)


def test_the_order_of_the_modes_does_not_matter():
    model = wells()
    times, z, _ = record(model, 4)
    first = run(model, times, z)
    for order in list(permutations(range(3)))[2:4]:
        names = [model.names[i] for i in order]
        turned = {name: model.modes[name] for name in names}
        other = run(sf.JumpMarkovModel(turned, model.rates[np.ix_(order, order)]), times, z)
        # on lattices, asked for .01, as a family knows nothing of the other well
        np.testing.assert_allclose(other.mode_probabilities, first.mode_probabilities[:, order], atol=5e-5)
        np.testing.assert_allclose(other.x, first.x, atol=5e-5)


def test_one_prediction_or_eight():
    one, eight = (sf.JumpMarkovFilter(wells(), READING, [0.5], [[0.1]]) for _ in range(2))
    one.predict(2.0)
    for t in np.arange(1, 9) * 0.25:
        eight.predict(t=t)
    assert one.t == eight.t
    np.testing.assert_allclose(one.mode_probabilities, eight.mode_probabilities, atol=1e-9)
    assert np.abs(one.x - eight.x) < 0.01 * np.sqrt(one.P[0, 0])
    for name, density in one.densities.items():
        assert abs(density.mean() - eight.densities[name].mean()) < 0.02 * np.sqrt(density.cov()[0, 0])


@pytest.mark.parametrize(
    ("rates", "options", "step"),
    [
        ([[-300.0, 300.0], [150.0, -150.0]], {}, 0.002),
        ([[-1e-9, 1e-9], [1e-9, -1e-9]], {}, 0.01),
        ([[-0.1, 0.1], [0.1, -0.1]], {"mode_probabilities": [1.0, 0.0]}, 0.01),
        ([[0.0, 0.0], [0.5, -0.5]], {"mode_probabilities": {"moving": 1.0}}, 0.01),
        ([[-0.1, 0.1], [0.1, -0.1]], {"n_particles": 100}, 0.01),
        ([[-0.1, 0.1], [0.1, -0.1]], {"config": CLOUDS}, 0.01),
    ],
    ids=["fast", "slow", "certain", "absorbing", "a number", "clouds"],
)
def test_rates_starts_and_schemes_of_all_kinds(rates, options, step):
    model, times = moving(rates), np.arange(1.0, 6.0)
    z = [[0.3], None, [1.1], [1.2], [2.3]]
    found = run(model, times, z, **options)
    start = options.get("mode_probabilities", model.stationary)
    start = [0.0, 1.0] if isinstance(start, dict) else start
    told = {"mode_probabilities": start, "box": (-4.0, 9.0), "size": 601, "step": step}
    grid = unsplit_jump_filter(model, READING, 0.0, 0.1, times, z, **told)
    assert np.abs(found.mode_probabilities - grid[:, 3:]).max() < 0.01
    assert np.abs((found.x[:, 0] - grid[:, 0]) / np.sqrt(grid[:, 1])).max() < 0.03


def test_a_mode_that_a_reading_excludes_loses_its_probability_and_may_come_again():
    def near(z, X, t):
        return -12.5 * (z[0] - X[:, 0]) ** 2

    def never(z, X, t):
        return np.full(len(X), -np.inf)

    sensors = {"rest": sf.LikelihoodMeasurement(near), "moving": sf.LikelihoodMeasurement(never)}
    flt = sf.JumpMarkovFilter(moving(), sensors, [0.0], [[0.1]])
    flt.predict(1.0)
    info = flt.update([0.1])
    assert list(flt.densities) == ["rest"] == list(info.modes)
    assert flt.mode_probabilities.tolist() == [1.0, 0.0]
    flt.predict(1.0)
    assert flt.mode_probabilities[1] == pytest.approx(flt.model.transition(1.0)[0, 1])
    before = flt.x, flt.P, flt.t, flt.log_evidence, flt.mode_probabilities.tolist()
    with pytest.raises(sf.PropagationError, match="zero wherever"):
        flt.update([0.1], sf.LikelihoodMeasurement(never))
    with pytest.raises(sf.ModelError):
        flt.update([0.1, 0.2], READING)
    with pytest.raises(sf.ModelError, match="back in time"):
        flt.predict(-1.0)
    assert (flt.x, flt.P, flt.t, flt.log_evidence, flt.mode_probabilities.tolist()) == before


def test_angles_of_all_modes_go_round():
    domain = [("periodic", -np.pi, np.pi)]
    modes = {
        name: sf.SDE.from_expressions(["a"], [rate], [["0.3"]], domain=domain)
        for name, rate in (("slow", "0.5"), ("fast", "1.5"))
    }
    model = sf.JumpMarkovModel(modes, [[-0.3, 0.3], [0.3, -0.3]])
    compass = sf.GaussianMeasurement(lambda x: (x[0],), [[0.05]], angles=[0])
    flt = sf.JumpMarkovFilter(model, compass, [3.0], [[0.05]])
    line = {name: drifting(rate, 0.3) for name, rate in (("slow", 0.5), ("fast", 1.5))}
    rolled = sf.JumpMarkovFilter(
        sf.JumpMarkovModel(line, model.rates), sf.GaussianMeasurement([[1.0]], [[0.05]]), [3.0], [[0.05]]
    )
    for z in (3.9, 4.4, 5.4):
        for each, reading in ((flt, (z + np.pi) % (2.0 * np.pi) - np.pi), (rolled, z)):
            each.predict(1.0)
            each.update([reading])
    np.testing.assert_allclose(flt.mode_probabilities, rolled.mode_probabilities, atol=5e-3)
    assert domain[0][1] <= flt.x[0] < domain[0][2]
    assert abs(flt.x[0] + 2.0 * np.pi - rolled.x[0]) < 0.02 * np.sqrt(rolled.P[0, 0])


def test_the_density_of_all_modes_is_their_sum():
    flt = sf.JumpMarkovFilter(wells(), READING, [0.5], [[0.1]])
    flt.predict(1.0)
    flt.update([0.4])
    X = flt.x + np.linspace(-2.0, 2.0, 9)[:, None] * np.sqrt(flt.P[0, 0])
    parts = zip(flt.mode_probabilities, flt.densities.values(), strict=True)
    summed = sum(w * p.pdf(X) for w, p in parts)
    np.testing.assert_allclose(flt.density.pdf(X), summed, rtol=0.02)
    np.testing.assert_allclose(np.exp(flt.spread().logpdf(X)), summed, rtol=1e-9)
    spread = flt.spread()
    assert spread.w @ spread.X == pytest.approx(flt.x, abs=0.01 * np.sqrt(flt.P[0, 0]))
    assert flt.mode == flt.model.names[np.argmax(flt.mode_probabilities)]


def test_the_same_input_gives_the_same_bits_and_a_copy_goes_on_by_itself():
    times, z, _ = record(wells(), 2)
    flt = sf.JumpMarkovFilter(wells(), READING, [0.0], [[0.1]])
    copied = pickle.loads(pickle.dumps(flt))
    one, other = (each.run(times, z) for each in (flt, copied))
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(one.mode_probabilities, other.mode_probabilities)


@pytest.mark.parametrize("build", [wells, moving])
def test_a_filter_from_a_file_goes_on_to_the_same_bits(tmp_path, build):
    model, path = build(), tmp_path / "filter.npz"
    times, z, _ = record(model, 6)
    config = sf.FilterConfig(target_error=0.02)
    flt = sf.JumpMarkovFilter(model, READING, [0.0], [[0.1]], dt=0.5, config=config)
    flt.run(times[:3], z[:3])
    flt.predict(t=times[3])  # the reading may ask for that again
    flt.save(path)
    again = sf.JumpMarkovFilter.load(path, build(), READING, window=2)
    assert repr(again) == repr(flt)
    for one in (flt, again):
        one.update(z[3])
        one.run(times[4:], z[4:])
        one.predict()
    assert again.log_evidence == flt.log_evidence
    for name in ("mode_probabilities", "x", "P", "x_post", "P_prior", "y", "S", "z"):
        assert np.array_equal(getattr(again, name), getattr(flt, name)), name
    assert again.config == flt.config
    again.update_late(0.1, again.t - 0.3)


def test_files_of_other_filters_are_refused(tmp_path):
    path = tmp_path / "filter.npz"
    sf.JumpMarkovFilter(moving(), READING, [0.0], [[0.1]], n_particles=np.int64(60)).save(path)
    with pytest.raises(sf.ModelError, match=r"of the modes \['rest', 'moving'\], not of"):
        sf.JumpMarkovFilter.load(path, wells(), READING)
    with pytest.raises(sf.ModelError, match="holds no filter: SPHFilter"):
        sf.SPHFilter.load(path, drifting(0.0), READING)
    sf.SPHFilter(drifting(0.0), READING, [0.0], [[0.1]]).save(path)
    with pytest.raises(sf.ModelError, match=r"JumpMarkovFilter\.save writes such files"):
        sf.JumpMarkovFilter.load(path, moving(), READING)


def test_an_outlying_reading_is_a_reason_and_no_flag():
    still = moving(np.zeros((2, 2)))
    flt = sf.JumpMarkovFilter(still, READING, [0.0], [[0.1]], mode_probabilities=[0.9, 0.1])
    flt.predict(1.0)
    info = flt.update(-2.6)
    assert not info.flagged
    assert "outlying" in info.reason
    assert info.status == "ok"
    assert info.code == sf.Code.OK


def several(noise):
    """Two sensors of one state, as the mode has them."""
    g, h = (sf.GaussianMeasurement([[a]], [[noise]]) for a in (1.0, 2.0))
    return sf.Sensors({"g": g, "h": h})


def test_readings_by_name_go_to_the_sensors_of_every_mode():
    sensors = {"rest": several(0.1), "moving": several(0.3)}
    named, alone, numbered = (sf.JumpMarkovFilter(moving(), sensors, [0.0], [[0.1]]) for _ in range(3))
    for flt in (named, alone, numbered):
        flt.predict(1.0)
    named.update({"g": 1.0})
    alone.update(1.0, "g")
    numbered.update([1.0, np.nan])
    assert named.log_evidence == pytest.approx(numbered.log_evidence, abs=1e-12)
    assert alone.log_evidence == pytest.approx(numbered.log_evidence, abs=1e-6)
    rows = sf.JumpMarkovFilter(moving(), sensors, [0.0], [[0.1]]).run([1.0], [{"g": 1.0}])
    assert rows.log_evidence[0] == pytest.approx(numbered.log_evidence, abs=1e-12)
    with pytest.raises(sf.ModelError, match="there is no sensor 'gg'"):
        named.update(1.0, "gg")
    turned = sf.Sensors({name: several(0.3)[name] for name in "hg"})
    with pytest.raises(sf.ModelError, match="same names in the same order"):
        sf.JumpMarkovFilter(moving(), {"rest": several(0.1), "moving": turned}, [0.0], [[0.1]])


def test_the_noise_of_one_reading_may_be_given():
    one, other = (sf.JumpMarkovFilter(moving(), READING, [[0.0]], [[0.1]]) for _ in range(2))
    for flt in (one, other):
        flt.predict(1.0)
    one.update(0.7, R=0.5)
    other.update(0.7, sf.GaussianMeasurement([[1.0]], [[0.5]]))
    assert one.log_evidence == other.log_evidence
    assert one.dim_x == one.dim_z == 1
    assert one.SI[0, 0] == pytest.approx(1.0 / one.S[0, 0])
    assert one.mahalanobis == pytest.approx(abs(one.y[0]) / np.sqrt(one.S[0, 0]))
    with pytest.raises(sf.ModelError, match="not both"):
        one.update(0.7, READING, R=0.5)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda flt: setattr(flt, "x", [1.0]), "the mean of a density filter cannot be overwritten"),
        (lambda flt: setattr(flt, "P", [[1.0]]), "make a new JumpMarkovFilter"),
        (lambda flt: setattr(flt, "mode_probabilities", [1.0, 0.0]), "read, not set"),
        (lambda flt: setattr(flt, "Q", 1.0), "JumpMarkovFilter has no Q to be set"),
        (lambda flt: setattr(flt, "n_particle", 10), "did you mean 'n_particles'"),
        (lambda flt: setattr(flt, "measurement", 3), "measurement must be"),
        (lambda flt: flt.x.__setitem__(0, 1.0), "read-only"),
        (lambda flt: flt.F, "JumpMarkovFilter has no F"),
        (lambda flt: flt.update(0.1, HJacobian=None), "takes no HJacobian="),
        (lambda flt: flt.update(0.1, "gps"), "measurement must be"),
    ],
)
def test_what_a_filter_has_found_is_read(change, sentence):
    flt = sf.JumpMarkovFilter(moving(), READING, [0.0], [[0.1]])
    with pytest.raises((sf.ModelError, AttributeError), match=sentence):
        change(flt)
    flt.log_evidence, flt.measurement = 1.0, {"rest": READING, "moving": several(0.1)["h"]}
    assert flt.log_evidence == 1.0
    assert flt.measurement is None


class Labelled(sf.JumpMarkovFilter):
    """A filter of a user's, with a name that the library's own refuses."""

    R: float


class Further(Labelled):
    """And one that is made of that."""


@pytest.mark.parametrize("kind", [Labelled, Further])
def test_subclasses_carry_what_they_like(tmp_path, kind):
    flt = kind(moving(), READING, [0.0], [[0.1]], dt=0.5)
    flt.R, flt.label = 3.0, "target 7"
    assert (flt.R, flt.label) == (3.0, "target 7")
    with pytest.raises(sf.ModelError, match="make a new JumpMarkovFilter"):
        flt.x = [1.0]
    flt.save(tmp_path / "filter.npz")
    again = kind.load(tmp_path / "filter.npz", moving(), READING)
    assert type(again) is kind and again.dt == 0.5


def test_parameters_are_fitted_by_a_function_that_makes_filters():
    flt = sf.JumpMarkovFilter(moving(), READING, [0.0], [[0.1]])
    with pytest.raises(sf.ModelError, match="give a function"):
        sf.fit_parameters(flt, [1.0], [0.3], guess={"a": 1.0})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"model": drifting(0.0)}, "SPHFilter takes an SDE"),
        ({"measurement": {"rest": READING}}, "one for each of"),
        ({"mode_probabilities": [0.5, 0.6]}, "sum to one"),
        ({"mode_probabilities": [1.5, -0.5]}, "not be negative"),
        ({"mode_probabilities": {"resting": 1.0}}, "did you mean 'rest'"),
        ({"n_particles": "many"}, "n_particles"),
    ],
)
def test_what_does_not_fit_is_refused(change, sentence):
    given = {"model": moving(), "measurement": READING, "x0": [0.0], "P0": [[0.1]]} | change
    with pytest.raises(sf.SphfilterError, match=sentence):
        sf.JumpMarkovFilter(**given)


class Wandering:
    """Cases of the model of two modes, for a campaign."""

    name = "wandering"

    def draw(self, rng):
        times, x0, P0 = np.arange(1.0, 9.0), np.zeros(1), np.array([[0.1]])
        start = rng.normal(0.0, np.sqrt(0.1), 1)
        truth, z = sf.simulate(moving(), READING, start, np.r_[0.0, times], rng)
        return sf.Case(times, truth[1:], z[1:], x0, P0)


@pytest.mark.slow
def test_a_campaign_finds_the_densities_consistent():
    def jumping(case, rng):
        return sf.JumpMarkovFilter(moving(), READING, case.x0, case.P0)

    campaign = sf.run_campaign(Wandering(), {"jumping": jumping}, n_runs=60, seed=4)
    assert not campaign.failures
    told = sf.report(campaign).filters["jumping"]
    assert min(told.ranks.hpd_p, *told.ranks.pit_p, *told.ranks.state_pit_p) > 0.01, told.ranks
    assert told.verdict.startswith(("consistent", "nothing found against it")), told.verdict


def test_a_sum_asks_for_points_as_its_shares_say():
    """What is next to never so and hard to read, as clutter far out, does not ask for all of its points."""
    density = sf.initialize(sf.Gaussian([0.0, 0.0], np.eye(2)), "auto")
    cloud, _ = sf.predict(
        density, sf.LinearSDE(-np.eye(2), noise=np.eye(2)), 0.5, sf.SolverConfig(scheme="cloud")
    )
    usual, hard = (cloud.noted(needs=Memory(points=points)) for points in (1024, 65536))
    shifted = replace(hard, x=hard.x + 3.0)
    for share, asked in ((1e-4, 2048), (0.5, 65536)):
        parts = [Part(np.log1p(-share), usual), Part(np.log(share), shifted)]
        assert mixed(parts, 0.01, Allowed(1e-6, 1e-6)).needs.points == asked
