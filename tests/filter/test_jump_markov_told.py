"""Modes that go as points: what errors they tell, and readings that ask for more points."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.modes import ModeDensities
from sphfilter.prediction.jumping import Way
from sphfilter.prediction.mixing_modes import mixture

P0 = 0.1 * np.eye(2)
BENT = (("slow", 0.17, 0.0, "0.48"), ("fast", -1.07, 1.07, "0.1"))
BENT_RATES = [[-0.001, 0.001], [0.2, -0.2]]


def pendulum(rates=((-0.8, 0.8), (1.2, -1.2))):
    free, pushed = (
        sf.SDE.from_expressions(["a", "v"], ["v", f"-4*sin(a) - 0.3*v + {push}"], [["0"], ["1"]], [[0.3]])
        for push in (0, 3)
    )
    return sf.JumpMarkovModel({"free": free, "pushed": pushed}, np.array(rates))


def filter_of(noise, **options):
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[noise]])
    return sf.JumpMarkovFilter(pendulum(), sensor, [0.3, 0.0], P0, config=sf.FilterConfig(**options))


def readings(noise, count, seed=1):
    times = 0.7 * np.arange(count + 1)
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[noise]])
    return times[1:], sf.simulate_modes(pendulum(), sensor, [0.3, 0.0], times, rng=seed).z[1:]


def test_doubt_of_probabilities_is_in_the_error_of_the_mean():
    w, v = np.array([0.7, 0.3]), np.array([0.01, 0.04])
    densities = [sf.initialize(sf.Gaussian([m], [[0.5]])) for m in (-1.0, 2.0)]
    modes = ModeDensities(np.log(w), densities, unsure=v)
    mean, cov = modes.moments
    off = (np.array([-1.0, 2.0]) - mean[0]) / np.sqrt(cov[0, 0])  # what each w moves the mean by
    np.testing.assert_allclose(modes.in_doubt, w * np.expm1(np.sqrt(v)))
    assert modes.error == pytest.approx(np.sqrt(off**2 @ modes.in_doubt**2))
    assert ModeDensities(np.log(w), densities).error == 0.0


def test_jumps_even_out_the_doubt_of_probabilities():
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]))
    modes = ModeDensities(np.log([0.5, 0.5]), [start, start], unsure=np.array([0.04, 0.0]))
    half = np.log1p(0.5 * np.expm1(0.2)) ** 2
    for P, left in (([[1.0, 0.0], [0.0, 1.0]], [0.04, 0.0]), ([[0.5, 0.5], [0.5, 0.5]], [half, half])):
        way = Way(np.array([0.0, 0.5, 1.0]), (np.array(P),))
        unsure, wrong = way.in_doubt(modes)
        np.testing.assert_allclose(unsure, left, atol=1e-15)
        assert not wrong.any()  # of densities that are alike, whatever their weights


def test_jumps_make_of_doubt_of_probabilities_one_of_the_density():
    parts = [sf.initialize(sf.Gaussian([m], [[0.01]])) for m in (-1.0, 1.0)]
    modes = ModeDensities(np.log([0.5, 0.5]), parts, unsure=np.array([0.01, 0.01]))
    off = modes.in_doubt[0]
    for P, wrong in ((np.eye(2), 0.0), (np.full((2, 2), 0.5), np.sqrt(2.0) * off * 0.5)):
        way = Way(np.array([0.0, 0.5, 1.0]), (P,))
        np.testing.assert_allclose(way.in_doubt(modes)[1], wrong, rtol=0.01)


def test_explanations_that_are_added_keep_the_doubt_of_their_modes():
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), "auto")
    modes = ModeDensities(np.log([0.7, 0.3]), [start, start], unsure=np.array([0.04, 0.01]))
    found = mixture([(0.2, modes), (0.5, modes)], sf.FilterConfig())
    np.testing.assert_allclose(found.unsure, modes.unsure, rtol=1e-9)


def test_where_steps_of_a_model_that_bends_are_wrong_is_not_known():
    """A light mode, of which steps get a half wrong, makes a third of a posterior."""
    modes = {k: sf.SDE.from_expressions(["x"], [f"{a}*x + {b} + sin(2*x)"], [[g]]) for k, a, b, g in BENT}
    model, sensor = sf.JumpMarkovModel(modes, BENT_RATES), sf.GaussianMeasurement([[1.0]], [[0.004]])
    found = []
    for target in (0.1, 0.003):
        flt = sf.JumpMarkovFilter(
            model, sensor, [-1.0], [[0.06]], config=sf.FilterConfig(target_error=target)
        )
        flt.predict(2.0)
        found.append((flt.update([0.08]), flt.mode_probabilities[1]))
    (rough, w), (fine, exact) = found
    assert abs(w - exact) < max(0.1, 2.0 * rough.splitting_error)
    assert abs(rough.log_evidence - fine.log_evidence) < 3.0 * rough.evidence_error


def test_a_cloud_of_modes_knows_its_ancestors_and_the_doubt_of_its_evidence():
    flt = filter_of(0.04, scheme=sf.CloudScheme(n_points=512))
    for k, (t, z) in enumerate(zip(*readings(0.04, 8), strict=True), 1):
        flt.predict(t=t)
        priors = [density.cloud.points for density in flt.densities.values()]
        assert all(len(points.older) == min(k - 1, 5) for points in priors)
        if k > 1:  # of points that were in one mode at the last reading, those of all modes are relatives
            first, other = (set(points.older[0].tolist()) for points in priors)
            assert first & other and max(first | other) < 2 * sum(len(points.w) for points in priors)
        before = flt._state.density.unsure.copy()
        info = flt.update(z)
        added = [info.modes[name].evidence_error ** 2 for name in flt.model.names]
        by_jumps = flt._state.density.unsure - before - added
        assert (by_jumps > -1e-12).all() and by_jumps.max() < 3.0 * info.splitting_error**2
    assert [len(p.cloud.points.lineage) for p in flt.densities.values()] == [6, 6]


def test_a_sharp_reading_is_made_again_on_more_points():
    """Of points that a few in a hundred of carry a reading, 512 are off by five of these targets."""
    target, few = 0.03, filter_of(1e-3, scheme=sf.CloudScheme(n_points=512))
    flt, fine = filter_of(1e-3, target_error=target), filter_of(1e-3, scheme=sf.CloudScheme(n_points=2**15))
    off = []
    for t, z in zip(*readings(1e-3, 4), strict=True):
        for each in (flt, few, fine):
            each.predict(t=t)
            told = each.update(z).error if each is not few else None
            off += [told] if each is flt else []
    assert max(off) < 2.5 * target < max(np.abs(few.x - fine.x) / np.sqrt(np.diag(fine.P)))
    assert np.sqrt(np.mean((flt.x - fine.x) ** 2 / np.diag(fine.P))) < 1.5 * target


def test_a_file_keeps_the_doubt_of_probabilities(tmp_path):
    flt = filter_of(0.04, target_error=0.05)
    flt.run(*readings(0.04, 2))
    flt.save(tmp_path / "modes.npz")
    again = sf.JumpMarkovFilter.load(tmp_path / "modes.npz", flt.model, flt.measurement)
    assert again._state.density.error == flt._state.density.error
    assert np.array_equal(again._state.density.unsure, flt._state.density.unsure)
