"""Time and error of filters in discrete time beside a bootstrap particle filter, in one run.

    python tests/filter/discrete_beside.py

Errors of means are rms over readings and states, in standard deviations of the posterior; of the reference,
a grid in one state, else 2^18 points. Particles so many that the filter of points is as far off: its error
falls as N^-1/2, measured at 10,000 (the mean square of four seeds).
"""

import time

import numpy as np

import sphfilter as sf
from reference_filters.discrete import BootstrapFilter, GridOfSteps

#: States, transition, covariance, what is read, its variance, mean and variance of the start.
SCENES = {
    "growth": ("x", "x/2 + 25*x/(1 + x**2) + 8*cos(1.2*t)", [10.0], "x**2/20", 1.0, [0.1], 2.0),
    "wells": ("x v", "x + 0.4*v; 0.9*v + 0.4*(2*tanh(2*x) - x)", [0.02, 0.1], "x**2", 0.2, [0.5, 0.0], 0.5),
    "predators": (
        "a b", "a + 0.2*(1 - exp(b)); b + 0.2*(exp(a) - 1)", [0.01] * 2, "exp(a)", 0.05, [0.5, 0.0], 0.1
    ),
    "turning": (
        "x y s h", "x + s*cos(h); y + s*sin(h); s; h", [0.01] * 3 + [0.02], "sqrt(x**2 + y**2); x - y", 0.1,
        [3.0, 2.0, 1.0, 0.0], 0.2,
    ),
}  # fmt: skip
TIMES, SEEDS = np.arange(1.0, 31.0), range(4)


def problem(name):
    states, transition, Q, h, R, x0, variance = SCENES[name]
    states, transition, h = states.split(), transition.split("; "), h.split("; ")
    model = sf.DiscreteModel.from_expressions(states, transition, covariance=np.diag(Q))
    sensor = sf.GaussianMeasurement.from_expressions(states, h, R * np.eye(len(h)))
    _, z = sf.simulate(model, sensor, x0, np.append(0.0, TIMES), rng=1)
    return model, sensor, z[1:], (x0, variance * np.eye(len(x0)))


def reference(model, sensor, z, start):
    """Means and standard deviations (T, n)."""
    if model.dim == 1:
        log_l = lambda number, x: sensor.log_likelihood(number, x[:, None], 0.0)  # noqa: E731
        grid = GridOfSteps(model, log_l, (start[0][0], start[1][0, 0] ** 0.5), 45.0, z, nodes=4001)
        return tuple(part[:, None] for part in grid.moments(grid.each))
    config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=2**18))
    found = sf.SPHFilter(model, sensor, *start, config=config).run(TIMES, z)
    return found.x, np.sqrt(np.diagonal(found.P, axis1=1, axis2=2))


def timed(run):
    """What a run gives, and the least time of three, seconds."""
    took = []
    for _ in range(3):
        began = time.perf_counter()
        found = run()
        took.append(time.perf_counter() - began)
    return found, min(took)


def main():
    """Print the table."""
    print(
        f"{'':10}{'asked':>6}{'made':>9}{'told':>9}{'ms':>7}{'particles for that':>22}{'ms':>9}{'times':>8}"
    )
    for name in SCENES:
        model, sensor, z, start = problem(name)
        mean, std = reference(model, sensor, z, start)
        squares = []
        for seed in SEEDS:
            run = lambda: BootstrapFilter(model, sensor, *start, 10_000, rng=seed).run(TIMES, z)  # noqa
            means, each = timed(run)
            squares.append(np.mean(((means - mean) / std) ** 2))
        for target in (0.1, 0.03, 0.01, 0.003):
            config = sf.FilterConfig(target_error=target)
            run = lambda: sf.SPHFilter(model, sensor, *start, config=config).run(TIMES, z)  # noqa
            found, own = timed(run)
            made = np.sqrt(np.mean(((found.x - mean) / std) ** 2))
            count = 10_000 * np.mean(squares) / made**2
            took = each * count / 10_000
            told = np.sqrt(np.mean(found.error**2))
            print(f"{name:10}{target:6g}{made:9.2g}{told:9.2g}{1e3 * own:7.0f}{count:22,.0f}{1e3 * took:9.0f}"
                  f"{took / own:8.1f}")  # fmt: skip


if __name__ == "__main__":
    main()
