"""Smoothing of models that change in time: steps back end where these jump."""

from itertools import pairwise

import numpy as np
import pytest
from density_cases import off

import sphfilter as sf

LEVEL = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
READINGS = ([0.3], [1.2], [0.4])


def smoothed(drift, variance, times, readings, jumps):
    """Rauch, Tung and Striebel's means, variances and the log-evidence of dx = (-x/2 + drift) dt + noise."""
    x, P, t0, log_evidence, steps = 0.0, 0.3, 0.0, 0.0, []
    for t, z in zip(times, readings, strict=True):
        ends = np.unique([t0, *(s for s in jumps if t0 < s < t), t])
        s = np.concatenate([np.linspace(*piece, 8001)[1::2] for piece in pairwise(ends)])
        ds, decay, kept = np.repeat(np.diff(ends) / 4000, 4000), np.exp((s - t) / 2), np.exp((t0 - t) / 2)
        ahead, spread = kept * x + decay * drift(s) @ ds, kept**2 * P + decay**2 * variance(s) @ ds
        x, P, t0 = ahead, spread, t
        if z is not None:
            S = spread + 0.1
            log_evidence -= 0.5 * (np.log(2.0 * np.pi * S) + (z[0] - ahead) ** 2 / S)
            x, P = ahead + spread / S * (z[0] - ahead), spread * 0.1 / S
        steps.append((kept, ahead, spread, x, P))
    out = [(x, P)]
    for (kept, ahead, spread, _, _), (*_, x, P) in zip(steps[:0:-1], steps[-2::-1], strict=True):
        gain = P * kept / spread
        out.append((x + gain * (out[-1][0] - ahead), P + gain**2 * (out[-1][1] - spread)))
    x, P = np.array(out[::-1]).T
    return x[:, None], P[:, None, None], log_evidence


def text(drift, noise):
    return sf.SDE.from_expressions(["x"], [f"-x/2 + {drift}"], [[noise]])


def pulse(t, height=50.0):
    return height * ((t > 1.3) & (t < 1.33))


def calm(t):
    return np.full(len(t), 0.25)


def step(before, after, at):
    return lambda t: np.where(t < at, before, after)


def called():
    return sf.SDE(lambda x, t: (-0.5 * x[0] + 50.0 * (1.3 < t < 1.33),), 1, [[0.5]], events=[1.3, 1.33])


#: Model, drift and variance of the noise as functions of time, and when they jump.
CASES = {
    "noise": (
        lambda: text("0", "where(t > 1.3 and t < 1.33, 5, 0.5)"),
        np.zeros_like,
        lambda t: 0.25 + pulse(t, 24.75),
        (1.3, 1.33),
    ),
    "drift": (lambda: text("where(t > 1.3 and t < 1.33, 50, 0)", "0.5"), pulse, calm, (1.3, 1.33)),
    "events": (called, pulse, calm, (1.3, 1.33)),
    "at a reading": (
        lambda: text("where(t < 2, 3, -2)", "where(t < 2, 0.3, 1)"),
        step(3.0, -2.0, 2.0),
        step(0.09, 1.0, 2.0),
        (2.0,),
    ),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("parts", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_in_one_go_or_in_two(name, parts):
    """Measured: 5.5e-5, the evidence 1.2e-4; with steps over the jumps .1 and .3."""
    make, drift, variance, jumps = CASES[name]
    times = np.arange(1, 3 * parts + 1) / parts
    z = [READINGS[k // parts] if k % parts == parts - 1 else None for k in range(3 * parts)]
    found = sf.smooth(sf.SPHFilter(make(), LEVEL, [0.0], [[0.3]], n_particles=50), times, z)
    x, P, log_evidence = smoothed(drift, variance, times, z, jumps)
    mean, cov = off(found.x, found.P, x, P)
    assert mean.max() < 1e-3 and cov.max() < 1e-3
    assert np.abs(found.log_evidence - log_evidence).max() < 1e-3
    np.testing.assert_array_equal(found.t, times)


def test_jumps_that_rounding_keeps_apart_are_one():
    """Beside a reading and beside each other."""
    model = text("where(3*t < 0.9*3, 3, -2)", "where(t < 0.3*3, 0.5, 0.8)")
    times = [0.45, 0.9, 1.35]
    found = sf.smooth(sf.SPHFilter(model, LEVEL, [0.0], [[0.3]], n_particles=50), times, READINGS)
    x, P, log_evidence = smoothed(step(3.0, -2.0, 0.9), step(0.25, 0.64, 0.9), times, READINGS, (0.9,))
    mean, cov = off(found.x, found.P, x, P)
    assert mean.max() < 1e-3 and cov.max() < 1e-3
    assert np.abs(found.log_evidence - log_evidence).max() < 1e-3
