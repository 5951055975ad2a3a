"""The ladder, ``n_particles="auto"``: what target errors ask for, against fine lattices and closed forms."""

import numpy as np
import pytest
from scipy import stats

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from sphfilter.campaign.campaign import draw_case
from sphfilter.core.cloud.control import MOST_POINTS
from sphfilter.density.memory import Memory, error_budget
from sphfilter.density.storage import from_bytes, to_bytes
from sphfilter.filter import update_again
from sphfilter.prediction.predict import Prediction


def made(scene, target, **options):
    scenario = load_scenario(scene)
    case = draw_case(scenario, 1, 0)
    options = {"n_particles": "auto", "config": sf.FilterConfig(target_error=target)} | options
    return case, sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, t0=case.t0, **options)


def followed(flt, case, end):
    """Infos, means and covariances of the first updates."""
    told, x, P = [], [], []
    for t, z in zip(case.times[:end], case.z[:end], strict=True):
        told.append((flt.predict(t=t), flt.update(z)))
        x.append(flt.x)
        P.append(flt.P)
    return told, np.array(x), np.array(P)


def test_a_gaussian_through_a_linear_model_is_kalmans():
    model = sf.LinearSDE([[0.0, 1.0], [-1.0, -0.3]], noise=[[0.0], [0.5]])
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    flt = sf.SPHFilter(model, sensor, [1.0, 0.0], np.eye(2), n_particles="auto")
    m, P = np.array([1.0, 0.0]), np.eye(2)
    for z in (0.3, -0.7, 0.1):
        predicted, updated = flt.predict(0.8), flt.update(z)
        F, b, Q = model.discretize(0.8)
        m, P = F @ m + b, F @ P @ F.T + Q
        S = P[0, 0] + 0.2
        evidence = -0.5 * ((z - m[0]) ** 2 / S + np.log(2 * np.pi * S))
        m, P = m + P[:, 0] / S * (z - m[0]), P - np.outer(P[:, 0], P[0]) / S
        np.testing.assert_allclose(flt.x, m, atol=1e-9)
        np.testing.assert_allclose(flt.P, P, atol=1e-9)
        assert updated.log_evidence == pytest.approx(evidence, abs=1e-9)
        assert predicted.rung == "closed form" and updated.rung == "family"
        assert not predicted.flagged and not updated.flagged


@pytest.mark.parametrize(
    ("scene", "target", "options", "rung"),
    [
        ("duffing", 0.1, {}, "cloud"),  # which costs less than a family, and is all that is asked for
        ("pendulum", 0.01, {}, "family"),
        ("duffing", 0.1, {"density_error": 0.05}, "family"),
        ("falling_body", 0.03, {}, "cloud"),
        ("cart", 0.1, {}, "cloud"),
        ("cart", 0.03, {}, "family"),
    ],
)
def test_where_little_is_asked_a_gaussian_becomes_points(scene, target, options, rung):
    case, flt = made(scene, target, config=sf.FilterConfig(target_error=target, **options))
    assert flt.predict(t=case.times[0]).rung == rung


def test_the_error_left_is_the_one_asked_for_and_cheaper_rungs_are_taken_where_it_allows():
    case, fine = made("van_der_pol", 0.01, n_particles=800, config=sf.FilterConfig(scheme="log_density"))
    _, x, P = followed(fine, case, 12)
    root = np.linalg.inv(np.linalg.cholesky(P))
    points = []
    for target in (0.06, 0.01):
        case, flt = made("van_der_pol", target)
        told, own, _ = followed(flt, case, 12)
        off = np.linalg.norm(np.einsum("tij,tj->ti", root, own - x), axis=1)
        assert np.sqrt(np.mean(off**2)) < 2.0 * target
        points.append(flt.density.needs.points)
        assert {predicted.rung for predicted, _ in told} <= {"family", "cloud"}
    assert 2 * points[0] <= points[1]


@pytest.mark.parametrize(
    ("scene", "target", "end", "rung"),
    [
        ("van_der_pol", 0.003, 3, "lattice"),
        ("cart", 0.02, 3, "family"),
        ("van_der_pol", 0.01, 6, "cloud"),
        ("three_oscillators", 0.1, 3, "cloud"),
    ],
)
def test_pure_verbs_and_files_go_on_to_the_same_bits(tmp_path, scene, target, end, rung):
    case, flt = made(scene, target)
    told, _, _ = followed(flt, case, end)
    assert rung in {predicted.rung for predicted, _ in told}
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", flt.model, flt.measurement)
    density, config = from_bytes(to_bytes(flt.density)), flt.config
    assert density.needs == flt.density.needs != Memory()
    for t, z in zip(case.times[end : end + 2], case.z[end : end + 2], strict=True):
        for each in (flt, again):
            each.predict(t=t)
            each.update(z)
        density, _ = sf.predict(density, flt.model, t=t, config=config)
        density, info = sf.update(density, flt.measurement, z, config)
        for other in (again.density, density):
            np.testing.assert_array_equal(flt.density.x, other.x)
            np.testing.assert_array_equal(flt.density.mass, other.mass)
            assert flt.density.needs == other.needs
    assert info.log_evidence == flt.log_likelihood


def test_verbs_alone_begin_with_auto():
    well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    start = sf.initialize(sf.Gaussian([1.0], [[0.02]]), "auto")
    assert start.read_out == "family" and start.needs == Memory()
    later, info = sf.predict(start, well, 0.3)
    assert later.needs is not None and info.status == "ok"
    fine = sf.predict(sf.initialize(sf.Gaussian([1.0], [[0.02]]), 400), well, 0.3)[0]
    assert abs(later.mean() - fine.mean()) < 0.02 * np.sqrt(fine.cov()[0, 0])
    two = sf.initialize(lambda X: np.exp(-((X[:, 0] ** 2 - 4) ** 2)), "auto", box=[[-4, 4]])
    assert two.field is not None and two.needs.nodes >= 60
    posterior, _ = sf.update(two, sf.GaussianMeasurement([[1.0]], [[9.0]]), [1.0])
    assert posterior.needs is not None


def test_whoever_knows_no_family_is_given_a_lattice():
    well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    start = sf.initialize(sf.Gaussian([1.0], [[0.1]]), "auto")
    again, info = sf.resample(start)
    assert info.n_particles >= 100
    np.testing.assert_allclose(again.mean(), [1.0], atol=1e-6)
    np.testing.assert_allclose(again.cov(), [[0.1]], rtol=0.02)
    ends = [
        sf.predict(start, well, 0.5, sf.SolverConfig(scheme=scheme))[0].mean()
        for scheme in ("log_density", "cloud", "family")
    ]
    np.testing.assert_allclose(ends, [ends[0]] * 3, atol=0.02)
    told = sf.propagate(start, well, [0.25, 0.5])
    np.testing.assert_allclose(told.densities[-1].mean(), ends[0], atol=1e-3)
    states = start.spread()
    np.testing.assert_allclose(states.w @ states.X, [1.0], atol=1e-3)


def test_a_family_that_rises_far_out_is_seen_to_be_off():
    """Moments go through a linear model exactly; polynomials that rise far out add a quarter to a P."""
    model = sf.LinearSDE([[-0.124]], noise=[[0.4431]])
    sensor = sf.GaussianMeasurement(lambda x, t: (x[0] ** 2,), [[0.157]])
    flt = sf.SPHFilter(model, sensor, [0.82], [[0.041]], n_particles="auto")
    flow, _, Q = model.discretize(0.467)
    for z in (0.741, 1.243, 1.421):
        P = flt.P
        info = flt.predict(0.467)
        np.testing.assert_allclose(flt.P, flow @ P @ flow.T + Q, rtol=max(6.0 * info.error, 0.003))
        flt.update(z)


@pytest.mark.parametrize("count", ["auto", 200])
def test_readings_that_leave_nothing_outside_cut_the_density_there(count):
    """A prior that does not spread is cut to an interval by every reading: to a cut Gaussian."""
    model = sf.LinearSDE([[-0.23]], noise=[[0.0]])
    inside = lambda z, X, t: np.where(abs(z[0] - X[:, 0]) <= 0.072, 0.0, -np.inf)  # noqa: E731
    sensor = sf.LikelihoodMeasurement(inside, 1)
    flt, low, high = sf.SPHFilter(model, sensor, [-1.6], [[0.016]], n_particles=count), -np.inf, np.inf
    for t, z in ((0.19, -1.44), (0.57, -1.296), (0.96, -1.152), (1.37, -1.008)):
        flt.predict(t=t)
        info, flow = flt.update(z), np.exp(-0.23 * t)
        low, high = max(low, (z - 0.072) / flow), min(high, (z + 0.072) / flow)
        scale = np.sqrt(0.016)
        exact = stats.truncnorm((low + 1.6) / scale, (high + 1.6) / scale, -1.6 * flow, scale * flow)
        assert abs(flt.x[0] - exact.mean()) < 3.0 * info.error * exact.std()
        assert abs(flt.P[0, 0] / exact.var() - 1.0) < 6.0 * info.error


def test_records_are_smoothed_on_lattices():
    well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    sensor, times = sf.GaussianMeasurement([[1.0]], [[0.1]]), 0.4 * np.arange(1, 6)
    _, z = sf.simulate(well, sensor, x0=[1.0], times=times, rng=3)
    made = [sf.SPHFilter(well, sensor, [1.0], [[0.1]], n_particles=n) for n in ("auto", 400)]
    auto, fine = (sf.smooth(flt, times, z) for flt in made)
    assert made[0].density.read_out == "family"
    np.testing.assert_allclose(auto.x, fine.x, atol=0.01)
    np.testing.assert_allclose(auto.log_evidence, fine.log_evidence, atol=0.03)


def test_a_target_that_is_missed_is_said():
    scenario = load_scenario("vehicle")
    case, flt = made("vehicle", 1e-4)
    flt.predict(t=case.times[0])
    info = flt.update(case.z[0])
    assert info.flagged and info.error > 1e-4 / np.sqrt(3)
    assert sf.Code.COARSE in info.code or sf.Code.UNRESOLVED in info.code
    assert scenario.model.dim == 3


@pytest.mark.parametrize("target", [0.02, 0.01])
def test_a_tail_that_a_family_got_wrong_and_a_reading_asks_for_is_predicted_again(target):
    scenario, start = load_scenario("duffing"), load_scenario("duffing").settings.start
    fine = {"n_particles": 1500, "config": sf.FilterConfig(scheme="log_density")}
    for z in (-3.4, -3.2, 5.0, 5.2):
        found = []
        for options in ({"config": sf.FilterConfig(target_error=target)}, fine):
            flt = sf.SPHFilter(scenario.model, scenario.measurement, start.mean, start.cov, **options)
            found.append((flt, flt.predict(2.0), flt.update([z])))
        (auto, predicted, updated), (exact, _, _) = found
        assert predicted.rung == ("family" if target > 0.01 else "cloud") and updated.rung != "family"
        off = np.sqrt(np.mean((auto.x - exact.x) ** 2 / np.diag(exact.P)))
        assert off < min(3.0 * updated.error, 2.0 * target) and not updated.flagged


def test_a_reading_of_two_modes_climbs_and_one_of_none_comes_down():
    well = sf.SDE.from_expressions(["x"], ["-x - 0.3*x**3"], [["1"]], [[0.5]])
    size = sf.GaussianMeasurement.from_expressions(["x"], ["abs(x)"], [[0.01]])
    direct = sf.GaussianMeasurement([[1.0]], [[0.05]])
    flt = sf.SPHFilter(well, size, [0.1], [[1.0]], n_particles="auto")
    assert flt.update([1.0]).rung == "lattice"
    assert flt.density.probability(lambda X: X[:, 0] > 0.0) == pytest.approx(0.55, abs=0.03)  # exp(0.2) to 1
    flt.update([1.0], direct)
    flt.predict(0.5)
    flt.update([0.8], direct)
    assert flt.density.probability(lambda X: X[:, 0] < 0.0) < 1e-3


def test_where_densities_are_asked_for_states_are_few_and_lattices_are_laid():
    well = sf.SDE.from_expressions(["x"], ["-x - 0.3*x**3"], [["1"]], [[0.5]])
    size = sf.GaussianMeasurement.from_expressions(["x"], ["abs(x)"], [[0.01]])
    config = sf.FilterConfig(density_error=0.01)
    flt = sf.SPHFilter(well, size, [0.1], [[1.0]], config=config)
    assert flt.update([1.0]).rung == "lattice"
    assert flt.density.pdf([[0.9], [-0.9]]).min() > 0.3
    assert sf.FilterConfig.from_toml(config.to_toml()) == config
    assert "density_error" not in repr(sf.FilterConfig())


def test_a_forced_scheme_keeps_to_it():
    case, flt = made("van_der_pol", 0.05, config=sf.FilterConfig(scheme="log_density", target_error=0.05))
    told, _, _ = followed(flt, case, 3)
    assert all(predicted.rung == updated.rung == "lattice" for predicted, updated in told)


def test_other_words_than_auto_are_refused():
    well = sf.LinearSDE([[-1.0]], noise=[[1.0]])
    with pytest.raises(sf.ModelError, match="'auto'"):
        sf.SPHFilter(well, None, [0.0], [[1.0]], n_particles="atuo")
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), 100)
    for verb in (
        lambda: sf.predict(start, well, 1.0, n_particles="many"),
        lambda: sf.initialize(sf.Gaussian([0.0], [[1.0]]), "many"),
    ):
        with pytest.raises(sf.ModelError, match="auto"):
            verb()


def test_a_failed_call_leaves_the_filter_as_it_was():
    calls = []

    def drift(X, t):
        calls.append(len(X))
        if len(calls) > 20:
            raise ZeroDivisionError("mine")
        return -X

    model = sf.SDE(drift=drift, dim=1, noise=[[0.5]], vectorized=True)
    flt = sf.SPHFilter(model, sf.GaussianMeasurement([[1.0]], [[0.1]]), [0.0], [[1.0]], n_particles="auto")
    before = flt.density
    with pytest.raises(ZeroDivisionError, match="mine"):
        for _ in range(20):
            flt.predict(0.5)
            before = flt.density
    assert flt.density is before


def test_waits_double_and_an_allowance_is_never_nothing():
    needs, waits = Memory(), []
    for _ in range(7):
        needs = needs.refused()
        waits.append(needs.waits)
    assert waits == [0, 1, 3, 7, 15, 15, 15]
    assert needs.followed(4).waits == 0 and needs.followed(4).failed == 0
    assert error_budget(0.0, 0.01) == 0.01 and error_budget(0.5, 0.01) == 0.005
    assert [Memory().cloud(0.1, dim) for dim in (1, 3, 6)] == [512, 1024, 2048]  # more numbers to tell
    assert Memory().cloud(1e-9, 1) == MOST_POINTS and Memory(points=512).cloud(1e-9, 1) == 512
    shares = [Memory(legs=k).shared for k in range(1, 2000)]
    assert shares[0] == 1.0 and sum(shares) < 2.62


def test_points_grow_at_once_and_shrink_after_readings_that_ask_for_fewer():
    needs = Memory(points=1024)
    assert needs.told(0.009, 0.01, 1024, 2).points == 1024
    assert needs.told(0.011, 0.01, 1024, 2).points == 2048
    assert needs.told(0.03, 0.01, 1024, 2).points == 2048 == needs.told(9.0, 0.01, 1024, 2).points
    assert Memory(points=MOST_POINTS).told(9.0, 0.01, MOST_POINTS, 2).points == MOST_POINTS
    assert Memory(points=8192).told(0.009, 0.01, 1024, 2).points == 8192  # once may be chance
    assert Memory(points=8192, calm=1).told(0.009, 0.01, 1024, 2).points == 1024


@pytest.mark.parametrize("parts", [1, 4])
def test_a_cloud_is_drawn_again_where_a_reading_leaves_too_few_points(tmp_path, parts):
    """A sharp reading after vague ones: what is told is true, and a saved filter does the same.

    Points of several predictions are drawn again from the last reading on, not from the last prediction.
    """
    scenario = load_scenario("lorenz")
    sharp = scenario.measurement.changed(noise_cov=0.01 * scenario.measurement.noise_cov)
    case, flt = made("lorenz", 0.05)
    followed(flt, case, 12)
    for t in np.linspace(*case.times[11:13], parts + 1)[1:]:
        assert flt.predict(t=t).rung == "cloud"
    origin, before = flt._state.origin, flt.density.cloud.size
    assert (origin.before.t, len(origin.legs)) == (case.times[11], parts)
    flt.save(tmp_path / "flt.npz")
    info = flt.update(case.z[12], sharp)
    assert info.error <= 1.5 * 0.05 or flt.density.cloud.size > before
    again = sf.SPHFilter.load(tmp_path / "flt.npz", scenario.model, scenario.measurement)
    again.update(case.z[12], sharp)
    np.testing.assert_array_equal(again.x, flt.x)


def test_a_cloud_that_misses_the_target_has_no_fewer_points_next():
    hasty = sf.FilterConfig(target_error=0.05, time_budget=60.0)  # else it would be predicted again
    case, flt = made("lorenz", 0.05, config=hasty)
    sharp = flt.measurement.changed(noise_cov=1e-6 * flt.measurement.noise_cov)
    followed(flt, case, 7)
    missed = 0
    for t, z in zip(case.times[7:11], case.z[7:11], strict=True):
        predicted, before = flt.predict(t=t), flt.density.needs.points
        flt.update(z, sharp)
        if predicted.rung == "cloud" and flt.density.cloud.told.decisive(0.05, 3) > 0.05:
            missed += 1
            assert flt.density.needs.points >= before
    assert missed


def test_a_reading_is_not_made_again_for_what_was_wrong_before_it(monkeypatch):
    """No number of points cures weights of two wells that were wrong when the interval began."""
    case, flt = made("duffing_square", 0.03)
    followed(flt, case, 9)
    cloud = flt.density.cloud
    one_sided = cloud.shadow.w * np.where(cloud.shadow.x[:, 0] > 0.0, 10.0, 1.0)
    parted = cloud._replace(shadow=cloud.shadow._replace(w=one_sided / one_sided.sum()))
    flt = sf.SPHFilter(flt.model, flt.measurement, density=flt.density.noted(cloud=parted), config=flt.config)
    flt.predict(t=case.times[9])
    monkeypatch.setattr(Prediction, "from_density", None)  # nothing is predicted again
    assert flt.update(case.z[9]).error > 1.5 * 0.03


def test_many_short_predictions_are_as_good_as_one():
    """A family that splits in two gives way in time, and points know their way through all parts."""
    case, flt = made("duffing", 0.01)
    _, fine = made("duffing", 0.01, n_particles=800, config=sf.FilterConfig(scheme="log_density"))
    before, rungs, off = case.t0, set(), []
    for t, z in zip(case.times[:3], case.z[:3], strict=True):
        for stop in np.linspace(before, t, 21)[1:]:
            rungs.add(flt.predict(t=stop).rung)
        fine.predict(t=t)
        told = flt.update(z)
        fine.update(z)
        before = t
        off.append(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(fine.P), flt.x - fine.x)))
        assert off[-1] < 3.0 * np.sqrt(2.0) * told.error
    assert np.sqrt(np.mean(np.square(off))) < 0.03
    assert rungs == {"family", "cloud"}


BOX = sf.LikelihoodMeasurement(
    lambda z, X, t: np.where(np.abs(X[:, 1:] - z[0]).max(axis=1) < 0.05, 0.0, -np.inf), dim_z=1
)
APART = sf.SDE.from_expressions(["a", "b", "c"], ["0", "0", "0"], [["0.01"], ["0.01"], ["0.01"]], [[1.0]])


@pytest.mark.parametrize("nothing_first", [False, True])
def test_no_reading_is_used_twice_where_nothing_leads_to_the_prior(nothing_first):
    first = sf.GaussianMeasurement([[1.0, 0.0, 0.0]], [[1.0]])
    flt = sf.SPHFilter(APART, first, np.zeros(3), np.eye(3))
    if nothing_first:
        flt.predict(1e-6)
        flt.update(None)
    flt.update([2.0])
    flt.update([0.5], BOX)
    assert flt.x[0] == pytest.approx(1.0, abs=0.05)
    assert flt.P[0, 0] == pytest.approx(0.5, abs=0.05)


def sines():
    """A filter of one state that two sensors read at one time, sharply."""
    model = sf.SDE.from_expressions(["x"], ["0.7*sin(2*x) - 0.7*x"], [["0.016"]], [[1.0]])
    bearing = sf.GaussianMeasurement.from_expressions(["x"], ["atan2(1, x - 1.7)"], [[0.02]], angles=[0])
    sine = sf.GaussianMeasurement.from_expressions(["x"], ["sin(1.56*x)"], [[0.00095]])
    return sf.SPHFilter(model, bearing, [-0.15], [[0.6]], config=sf.FilterConfig(target_error=0.01)), sine


@pytest.mark.parametrize("most", [update_again._MOST_EVALUATIONS, 1])
def test_a_reading_is_made_again_as_long_as_that_takes_no_more_than_a_try_may(monkeypatch, most):
    monkeypatch.setattr(update_again, "_MOST_EVALUATIONS", most)
    well = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v + x - 0.1*x**3"], [["0"], ["1"]])
    ring = sf.GaussianMeasurement.from_expressions(["x", "v"], ["x**2 + v**2"], [[1e-3]])
    flt = sf.SPHFilter(well, ring, [1.0, 0.0], np.eye(2))
    found = flt.run([1.0, 2.0], [4.0, 2.0])
    assert found.flagged[1] == (most == 1)  # else it is told, and said


def test_readings_of_one_time_are_made_again_together_where_the_last_finds_too_few_points():
    flt, sine = sines()
    flt.predict(0.36)
    flt.update([2.39])
    assert flt.update([0.864], sine).error < 0.02  # .046, not made again
    grid = sf.SPHFilter(
        flt.model,
        flt.measurement,
        [-0.15],
        [[0.6]],
        n_particles=400,
        config=sf.FilterConfig(scheme="log_density"),
    )
    grid.predict(0.36)
    grid.update([2.39])
    grid.update([0.864], sine)
    assert flt.x == pytest.approx(grid.x, abs=0.03 * grid.P[0, 0] ** 0.5)
    assert flt.log_evidence == pytest.approx(grid.log_evidence, abs=0.03)


def test_a_reading_that_did_not_come_leaves_the_others_together():
    found = []
    for between in ((), (None,)):
        flt, sine = sines()
        flt.predict(0.36)
        flt.update([2.39])
        for z in between:
            flt.update(z)
        flt.update([0.864], sine)
        found.append((flt.x[0], flt.P[0, 0]))
    assert found[0] == found[1]


def test_a_reading_is_kept_as_it_was():
    """The caller's array may hold the next reading before this one is asked for again."""
    found = []
    for z, later in ((np.array([2.39]), 0.5), (np.array([2.39]), 2.39)):
        flt, sine = sines()
        flt.predict(0.36)
        flt.update(z)
        z[0] = later
        flt.update([0.864], sine)
        found.append(flt.x[0])
    assert found[0] == found[1]
