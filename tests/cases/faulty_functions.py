"""Models whose functions go wrong at a certain call: raise, return NaN, or an array of another shape."""

import sys

import numpy as np
from numba import njit

import sphfilter as sf


class OwnError(Exception):
    """What no library would raise."""


class Faulty:
    """A function of rows of states that goes wrong at its call number `fails_at`, in one way."""

    def __init__(self, function, how, fails_at):
        self.function, self.how, self.fails_at = function, how, fails_at
        self.calls, self.raised = 0, None

    def __call__(self, X, t):
        """Return the function's rows, but for the one call."""
        assert len(X), "asked about no rows"
        self.calls += 1
        if self.calls != self.fails_at:
            return self.function(X, t)
        if self.how == "raise":
            self.raised = OwnError(f"call {self.calls}")
            raise self.raised
        return np.full_like(X, np.nan) if self.how == "nan" else np.zeros((len(X) + 1, 2))


def turn(X, t):
    """Coordinated turn: x, vx, y, vy, rate."""
    _, vx, _, vy, w = X.T
    return np.stack([vx, -w * vy, vy, w * vx, -0.1 * w], axis=1)


def faulty_filter(dim, how, fails_at, n_particles):
    """A filter of `dim` states on a drift that goes wrong, and that drift."""
    function = turn if dim == 5 else lambda X, t: -X - 0.1 * X**3
    drift = Faulty(function, how, np.inf)
    model = sf.SDE(drift, dim, noise=0.3 * np.eye(dim), vectorized=True)
    sensor = sf.GaussianMeasurement(np.eye(dim)[:1], [[0.5]])
    flt = sf.SPHFilter(model, sensor, np.ones(dim), 0.2 * np.eye(dim), n_particles=n_particles)
    drift.fails_at = drift.calls + fails_at
    return flt, drift


def behaves(dim, how, fails_at, n_particles):
    """Let a filter run into the fault; tells what is wrong about its way out, or nothing."""
    flt, drift = faulty_filter(dim, how, fails_at, n_particles)
    before = flt.density, flt.t
    try:
        for _ in range(3):
            before = flt.density, flt.t
            flt.predict(0.3)
            before = flt.density, flt.t
            flt.update([1.0])
    except OwnError as problem:
        if problem is not drift.raised:
            return f"another exception: {problem!r}"
    except sf.SphfilterError as problem:
        if how == "raise":
            return f"swallowed: {problem!r}"
    else:
        return "swallowed" if drift.raised else ""
    return "" if (flt.density, flt.t) == before else "the filter is not as it was"


@njit
def raising(x, t):
    """A compiled drift that raises where t > 0.2."""
    if t > 0.2:
        raise ValueError("beyond the table")
    return -x[0], -x[1], -x[2], -x[3], -x[4]


def compiled(n_particles):
    """What is wrong about the way out of a compiled drift's exception, or nothing."""
    start = sf.initialize(sf.Gaussian(np.ones(5), 0.2 * np.eye(5)), n_particles)
    try:
        sf.predict(start, sf.SDE(raising, 5, noise=0.3 * np.eye(5)), 1.0)
    except ValueError as problem:
        return "" if str(problem) == "beyond the table" else repr(problem)
    return "swallowed"


if __name__ == "__main__":
    seed, cases = map(int, sys.argv[1:3])
    rng = np.random.default_rng(seed)
    wrong = [compiled(2000)]
    wrong.append(behaves(5, "raise", 20, 2000))
    for _ in range(cases):
        dim = int(rng.integers(1, 6))
        how = str(rng.choice(["raise", "nan", "shape"]))
        case = dim, how, int(rng.integers(1, 200)), int(rng.choice([100, 400, 2000]))
        told = behaves(*case)
        wrong.append(told and f"{case}: {told}")
    print("\n".join(filter(None, wrong)), end="")
