"""States far away that a reading, or two of one time, leave little of: variances count them all the same."""

from dataclasses import replace

import numpy as np
import pytest

import sphfilter as sf
from experiments.stress.random_cases import RandomCase
from experiments.stress.records import default_filter

R = 0.001
BESIDE = sf.GaussianMeasurement(h=lambda x: np.abs(x[:1]), noise_cov=[[R]])
STILL = sf.LinearSDE(np.zeros((2, 2)), noise=np.zeros((2, 1)))


def summed(x, log_p):
    """Mean and covariance of a density of logarithm log_p (N,) over states x (N, n) of a grid."""
    p = np.exp(log_p - log_p.max())
    w = p / p.sum()
    mean = w @ x
    return mean, (w[:, None] * (x - mean)).T @ (x - mean)


def grid(*axes):
    """States (N, n) of a grid, of begin, end and number along each axis."""
    return np.stack(np.meshgrid(*[np.linspace(*ends) for ends in axes], indexing="ij"), axis=-1).reshape(
        -1, 2
    )


def gaussian(x, mean, cov):
    d = np.linalg.solve(np.linalg.cholesky(cov), (x - mean).T)
    return -0.5 * (d * d).sum(axis=0) - 0.5 * np.linalg.slogdet(2.0 * np.pi * np.asarray(cov))[1]


def off_by(flt, mean, cov):
    """Errors of mean and variances, in standard deviations and relative."""
    std = np.sqrt(np.diag(cov))
    return np.abs((flt.x - mean) / std).max(), np.abs(np.diag(flt.P) / std**2 - 1.0).max()


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


@pytest.mark.parametrize("nodes", [50, 300])
@pytest.mark.parametrize("share", [0.0001, 0.0003, 0.003])
def test_a_piece_far_away_stays_on_a_lattice(share, nodes):
    """What a lattice keeps of a piece that little of the probability lies in goes by how far away it is."""
    pieces = [([0.7, 0.0], np.diag([0.03, 1.0]), 1.0 - share), ([-0.7, 0.5], np.diag([0.03, 1.0]), share)]

    def log_p(x):
        return np.logaddexp(*(gaussian(x, mean, cov) + np.log(part) for mean, cov, part in pieces))

    start = sf.initialize(lambda x: np.exp(log_p(x)), n_particles=nodes, box=[(-1.6, 1.6), (-4.0, 4.5)])
    density, info = sf.update(start, BESIDE, [0.72])
    x = grid((-1.5, 1.5, 6001), (-5.0, 5.0, 201))
    exact = summed(x, log_p(x) - 0.5 * (0.72 - np.abs(x[:, 0])) ** 2 / R)
    assert density.mean() == pytest.approx(exact[0], abs=0.05 * np.sqrt(R))
    assert density.cov()[0, 0] == pytest.approx(exact[1][0, 0], rel=0.1) or info.flagged


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_readings_of_one_time_the_second_brings_out_what_the_first_left_out(turned):
    """7e-4 are left out of a posterior in many pieces; of that the next reading makes half of a variance."""
    problem = replace(RandomCase(60713, 45).problem(), n_particles="auto")
    flt = default_filter(problem)
    flt.predict(t=problem.times[0])
    mean, cov, noise = flt.x, flt.P, [sensor.noise_cov for sensor in problem.sensors]
    read = [z[0] for z in problem.z]
    x = grid((-1.0, 1.5, 801), (-4.0, 4.0, 801))
    log_p = gaussian(x, mean, cov) + gaussian(x, read[1], noise[1])  # the model is linear, and so is this one
    off = read[0] - problem.sensors[0].predict(x)[:, 0]
    exact = summed(x, log_p - 0.5 * off**2 / noise[0][0, 0])
    pairs = list(zip(read, problem.sensors, strict=True))
    infos = [flt.update(z, sensor) for z, sensor in (pairs[::-1] if turned else pairs)]
    assert off_by(flt, *exact) < (0.03, 0.1) and not infos[-1].flagged
