"""States far away that a reading, or two of one time, leave little of: variances count them all the same."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from posterior_cases import on_grid
from scipy.stats import multivariate_normal

import sphfilter as sf
from experiments.stress.random_cases import RandomCase
from experiments.stress.records import default_filter

R = 0.001
BESIDE = sf.GaussianMeasurement(h=lambda x: np.abs(x[:1]), noise_cov=[[R]])
STILL = sf.LinearSDE(np.zeros((2, 2)), noise=np.zeros((2, 1)))


def gaussian(mean, cov):
    """log N(x; mean, cov) of states x, as a function."""
    return multivariate_normal(mean, cov).logpdf


def test_one_family_does_not_hold_the_other_side_of_a_distance():
    """3e-4 of the posterior lie 23 of its standard deviations away, and are a sixth of its variance."""
    flt = sf.SPHFilter(
        STILL,
        BESIDE,
        x0=[0.2124, -0.5409],
        P0=[[0.018667, -0.024028], [-0.024028, 0.263614]],
        config=sf.FilterConfig(scheme=sf.FamilyScheme(degree=4)),
    )
    with pytest.raises(sf.PropagationError, match="other states explain the reading too"):
        flt.update([0.36534])


def test_what_other_states_widen_a_variance_by_is_told_of_a_family_and_asks_for_more():
    """2e-4 of the posterior lie 28 of its standard deviations away, and are an eighth of its variance."""
    x = np.linspace(-8.0, 9.0, 200_001)
    p = np.exp(-0.5 * (x - 1.33) ** 2 / 0.96 - 0.5 * (11.25 - x**2) ** 2 / 2.0)
    mean = np.average(x, weights=p)
    variance = np.average((x - mean) ** 2, weights=p)
    square = sf.GaussianMeasurement.from_expressions(["x"], ["x**2"], [[2.0]])
    still = sf.LinearSDE([[0.0]], noise=[[0.0]])
    flt = sf.SPHFilter(still, square, x0=[1.33], P0=[[0.96]])
    info = flt.update([11.25])
    assert info.scheme != "family" and not info.flagged
    assert flt.P[0, 0] == pytest.approx(variance, rel=1e-3)
    one = sf.SPHFilter(
        still, square, [1.33], [[0.96]], config=sf.FilterConfig(scheme=sf.FamilyScheme(degree=6))
    )
    told, made = one.update([11.25]).variance_error, abs(one.P[0, 0] / variance - 1.0)
    assert made > 0.1 and made / 3.0 < told < 3.0 * made


@pytest.mark.parametrize("nodes", [50, 300])
@pytest.mark.parametrize("share", [0.0001, 0.0003, 0.003])
def test_a_piece_far_away_stays_on_a_lattice(share, nodes):
    """What a lattice keeps of a piece that little of the probability lies in goes by how far away it is."""
    pieces = [([0.7, 0.0], np.diag([0.03, 1.0]), 1.0 - share), ([-0.7, 0.5], np.diag([0.03, 1.0]), share)]

    def log_p(x):
        return np.logaddexp(*(gaussian(mean, cov)(x) + np.log(part) for mean, cov, part in pieces))

    start = sf.initialize(lambda x: np.exp(log_p(x)), n_particles=nodes, box=[(-1.6, 1.6), (-4.0, 4.5)])
    density, info = sf.update(start, BESIDE, [0.72])
    exact = on_grid(
        lambda x: log_p(x) - 0.5 * (0.72 - np.abs(x[..., 0])) ** 2 / R, [(-1.5, 1.5), (-5.0, 5.0)], 1501
    )
    assert density.mean() == pytest.approx(exact.mean, abs=0.05 * np.sqrt(R))
    assert density.cov()[0, 0] == pytest.approx(exact.cov[0, 0], rel=0.1) or info.flagged


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_readings_of_one_time_the_second_brings_out_what_the_first_left_out(turned):
    """7e-4 are left out of a posterior in many pieces; of that the next reading makes half of a variance."""
    problem = replace(RandomCase(60713, 45).problem(), n_particles="auto")
    flt = default_filter(problem)
    flt.predict(t=problem.times[0])
    read = [z[0] for z in problem.z]
    prior, linear = gaussian(flt.x, flt.P), gaussian(read[1], problem.sensors[1].noise_cov)

    def log_p(x):
        return prior(x) + linear(x) + problem.sensors[0].log_likelihood(read[0], x)

    exact = on_grid(log_p, [(-1.0, 1.5), (-4.0, 4.0)], 801)
    pairs = list(zip(read, problem.sensors, strict=True))
    infos = [flt.update(z, sensor) for z, sensor in (pairs[::-1] if turned else pairs)]
    assert not infos[-1].flagged
    assert np.abs((flt.x - exact.mean) / np.sqrt(np.diag(exact.cov))).max() < 0.03
    assert np.diag(flt.P) == pytest.approx(np.diag(exact.cov), rel=0.1)


@pytest.mark.parametrize("predicted", [False, True])
def test_what_one_reading_left_out_counts_at_the_next(predicted):
    """5e-6 are left out 30 deviations away; a reading later, and an interval, they are most of a variance."""
    pieces = [(-np.log(0.997), 0.0), (-np.log(0.003), 30.0)]
    R, z = 92.0, (-5.0, 42.0)

    def log_p(x):
        return np.logaddexp(*(gaussian([mean], [[1.0]])(x) - off for off, mean in pieces))

    start = sf.initialize(lambda x: np.exp(log_p(x)), n_particles=300, box=[(-8.0, 38.0)])
    sensor, model = sf.GaussianMeasurement([[1.0]], [[R]]), sf.LinearSDE([[0.0]], noise=[[1e-3]])
    flt = sf.SPHFilter(model, sensor, density=start)
    infos = []
    for t, reading in enumerate(z, start=1):
        if predicted:
            flt.predict(t=float(t))
        infos.append(flt.update(reading))
        kept = pickle.loads(pickle.dumps(flt.density)).left_out
        assert all(map(np.array_equal, kept, flt.density.left_out))
    log_w = [-off + sum(gaussian([mean], [[1.0 + R]])([x]) for x in z) for off, mean in pieces]
    assert not infos[0].flagged
    share = 1.0 / (1.0 + np.exp(log_w[0] - log_w[1]))
    wider = share * (1.0 - share) * 30.0**2
    assert flt.P[0, 0] == pytest.approx(1.0 + wider, rel=0.1) or infos[1].flagged
    assert infos[1].variance_error == pytest.approx(wider, rel=0.1)
