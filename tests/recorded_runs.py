"""A fixed set of runs, recorded to the last bit, to hold two checkouts against each other.

    python tests/recorded_runs.py record FOLDER            # in one checkout ...
    python tests/recorded_runs.py compare FOLDER FOLDER    # ... and another, on the same machine and cache

Every scheme, filter, transient, smoother, fit and adapter takes part, by the public interface alone, and the
files that commands write. `compare` ends with 1 if a number differs.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import fields, is_dataclass
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # threads sum in an order of their own
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import sphfilter as sf

ROOT = Path(sys.path[0])
CLOCK = ("seconds", "run_time", "time_s", "run time", "wall", "duration")
CASES = {}


def case(make):
    """Add a function to the runs that are recorded; it yields names and values."""
    CASES[make.__name__] = make
    return make


def flat(prefix, value):
    """Numbers of a value, whatever it holds, as pairs of a name and an array."""
    if isinstance(value, sf.ParticleDensity):
        yield from answers(prefix, value)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if not any(word in field.name for word in CLOCK):
                yield from flat(f"{prefix}.{field.name}", getattr(value, field.name))
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from flat(f"{prefix}.{key}", item)
    elif hasattr(value, "_asdict"):
        yield from flat(prefix, value._asdict())
    elif isinstance(value, tuple | list) and not all(isinstance(v, str | bool | int | float) for v in value):
        for k, item in enumerate(value):
            yield from flat(f"{prefix}.{k}", item)
    elif value is None:
        yield prefix, np.array("None")
    elif isinstance(value, str | bool | int | float | np.ndarray | np.generic | tuple | list):
        array = np.asarray(value)
        if array.dtype != object:
            yield prefix, array


def answers(prefix, p):
    """What a density answers."""
    for name in ("x", "mass", "h", "t", "represented_mass", "read_out", "log_density", "invariant"):
        value = getattr(p, name)
        yield f"{prefix}.{name}", np.asarray("None" if value is None else value)
    X = p.mean() + np.linspace(-2.5, 2.5, 11)[:, None] * np.sqrt(np.diag(p.cov()))
    yield f"{prefix}.mean", p.mean()
    yield f"{prefix}.cov", p.cov()
    yield f"{prefix}.pdf", p.pdf(X)
    yield f"{prefix}.gradient", p.gradient(X)


def questions(prefix, p):
    """The dearer answers of a density."""
    X = p.mean() + np.linspace(-2.5, 2.5, 11)[:, None] * np.sqrt(np.diag(p.cov()))
    yield f"{prefix}.sample", p.sample(50, 3)
    yield f"{prefix}.entropy", np.asarray(p.entropy())
    yield f"{prefix}.quantile", np.asarray(p.quantile(0, [0.05, 0.5, 0.99]))
    yield f"{prefix}.hpd", p.hpd_rank(X)
    yield f"{prefix}.level", np.asarray(p.hpd_level(0.9))
    yield f"{prefix}.mode", p.mode()
    yield f"{prefix}.moment", np.asarray(p.moment([2] + [0] * (p.dim - 1)))
    yield f"{prefix}.probability", np.asarray(p.probability(lambda Y: Y[:, 0] > 0.5))
    states = p.spread()
    yield from flat(f"{prefix}.spread", states)
    if p.dim > 1:
        yield from answers(f"{prefix}.marginal", p.marginal([0]))


def text(states, drift, noise=(("0",), ("1",)), Q=((1.0,),), parameters=None, **options):
    return sf.SDE.from_expressions(states, drift, noise, Q, parameters or {}, **options)


def duffing():
    return text(
        ["x", "v"], ["v", "-c*v - x*(g + e*x**2)"], Q=[[1.6]], parameters={"c": 0.4, "g": -1.0, "e": 0.1}
    )


def van_der_pol():
    return text(["x", "v"], ["v", "-x + (1 - x**2)*v*.2"], Q=[[0.5]])


def lorenz():
    drift = ["10*(y - x)", "x*(28 - z) - y", "x*y - 8/3*z"]
    return text(["x", "y", "z"], drift, np.eye(3).astype(str).tolist(), 4 * np.eye(3))


def cart():
    drift = ["v", "-x - .3*v - .5*x**3 + .5*(y - x)", "w", "-y - .2*w + .5*(x - y)"]
    noise = [["0", "0"], ["1", "0"], ["0", "0"], ["0", "1"]]
    return text(["x", "v", "y", "w"], drift, noise, 0.3 * np.eye(2))


def position(n=2, R=0.2):
    return sf.GaussianMeasurement(h=np.eye(1, n), noise_cov=[[R]])


def told(name, model, sensor, x0, P0, times, seed=1, outlier=None, **options):
    """All epochs of a filter's run."""
    times = np.asarray(times, dtype=float)
    _, z = sf.simulate(model, sensor, x0=x0, times=times, rng=seed)
    if outlier is not None:
        z[outlier] += 9.0
    flt = sf.SPHFilter(model, sensor, x0=x0, P0=P0, t0=times[0], **options)
    for k, t in enumerate(times[1:], start=1):
        try:
            yield from flat(f"{name}.{k}.predict", flt.predict(t=t))
            yield from flat(f"{name}.{k}.update", flt.update(z[k]))
        except sf.SphfilterError as problem:
            yield f"{name}.{k}.problem", np.asarray(str(problem))
            break
        for key in ("x", "P", "x_prior", "P_prior", "y", "S", "log_likelihood", "log_evidence"):
            yield from flat(f"{name}.{k}.{key}", getattr(flt, key))
    yield from answers(f"{name}.density", flt.density)
    yield from questions(f"{name}.density", flt.density)


@case
def filters_2d():
    start = [3.0, 0.0], np.diag([0.2, 1.0])
    every = np.arange(0.0, 17.0, 2.0)
    schemes = {
        "default": sf.FilterConfig(),
        "paper": sf.FilterConfig.paper(),
        "log_density": sf.FilterConfig(scheme=sf.LogDensityScheme()),
        "accepting": sf.FilterConfig(acceptance=sf.AcceptanceTest(enabled=True)),
    }
    for name, config in schemes.items():
        yield from told(f"duffing.{name}", duffing(), position(), *start, every, config=config)
    yield from told("duffing.outlier", duffing(), position(), *start, every, outlier=4, n_particles=100)
    yield from told("duffing.auto", duffing(), position(), *start, every, n_particles="auto")
    yield from told("vdp", van_der_pol(), position(), [1.0, 0.0], np.eye(2), np.arange(0, 12, 1.0))


@case
def filters_other():
    def numba_drift(x, t):
        return x[1], -0.4 * x[1] - x[0] * (-1.0 + 0.1 * x[0] ** 2)

    def with_parameters(x, t, p):
        return p[0] * x[0] - x[0] ** 3

    def black_box(X, t):
        return np.stack([X[:, 1], -np.sin(X[:, 0]) - 0.2 * X[:, 1]], axis=1)

    noise, Q, every = [[0.0], [1.0]], [[1.0]], np.arange(0.0, 5.0, 1.0)
    own = sf.SDE(drift=numba_drift, dim=2, noise=noise, spectral_density=Q)
    yield from told("numba", own, position(), [3.0, 0.0], np.eye(2), every)
    own = sf.SDE(drift=with_parameters, dim=1, noise=[[1.0]], spectral_density=[[0.5]], parameters={"a": 1.0})
    yield from told("1d", own.with_parameters(a=1.2), position(1), [0.0], np.eye(1), every, n_particles=80)
    own = sf.SDE(drift=black_box, dim=2, noise=noise, spectral_density=Q, vectorized=True)
    yield from told("vectorized", own, position(), [1.0, 0.0], np.eye(2), every, n_particles=100)
    linear = sf.LinearSDE([[0.0, 1.0], [-1.0, -0.4]], noise=noise, spectral_density=Q)
    yield from told("linear", linear, position(), [1.0, 0.0], np.eye(2), every)
    no_short_cut = sf.FilterConfig(exact_linear=False)
    yield from told("linear.not", linear, position(), [1.0, 0.0], np.eye(2), every, config=no_short_cut)
    multiplicative = text(["x", "v"], ["v", "-x - .3*v"], [["0"], [".6*sqrt(.3 + x**2)"]])
    yield from told("noisy", multiplicative, position(), [1.0, 0.0], 0.3 * np.eye(2), every)
    strato = text(["x"], ["-x"], [[".6*sqrt(1 + .5*x**2)"]], interpretation="stratonovich")
    yield from told("strato", strato, position(1), [1.0], 0.3 * np.eye(1), every, n_particles=100)
    forced = text(["x", "v"], ["v", "-x**3 - .3*v + cos(2*t)"], [["0"], ["1 + .5*sin(t)"]])
    yield from told("forced", forced, position(), [1.0, 0.0], 0.3 * np.eye(2), every)
    circle = text(["a", "w"], ["w", "-sin(a) - .5*w"], domain=[["periodic", -np.pi, np.pi], "unbounded"])
    bearing = sf.GaussianMeasurement.from_expressions(["a", "w"], ["sin(a)", "cos(a)"], 0.1 * np.eye(2))
    yield from told("circle", circle, bearing, [3.0, 0.5], 0.3 * np.eye(2), every)
    yield from told(
        "lorenz", lorenz(), position(3, 1.0), [1.0, 1.0, 20.0], np.eye(3), 0.1 * np.arange(5), n_particles=600
    )
    yield from told("cart", cart(), position(4), [1.0, 0, 0, 0], 0.3 * np.eye(4), every[:4], n_particles=500)

    def counts(z, X, t):
        return z[0] * X[:, 0] - np.exp(X[:, 0])

    own = text(["x"], ["-x"], [["1"]])
    flt = sf.SPHFilter(own, sf.LikelihoodMeasurement(counts), [0.0], [[1.0]])
    for k, z in enumerate((2.0, None, 0.0, 5.0)):
        yield from flat(f"counts.{k}.predict", flt.predict(0.5))
        yield from flat(f"counts.{k}.update", flt.update(z))
    yield from answers("counts.density", flt.density)
    with tempfile.TemporaryDirectory() as folder:
        flt.save(Path(folder, "filter.npz"))
        other = sf.SPHFilter.load(Path(folder, "filter.npz"), own, flt.measurement)
    other.predict(0.3), other.update(1.0)
    yield from answers("counts.loaded", other.density)
    two = sf.GaussianMeasurement(np.eye(2), 0.2 * np.eye(2))
    flt = sf.SPHFilter(duffing(), two, [3.0, 0.0], np.eye(2), dt=1.0)
    times, z = np.arange(6.0), np.array([[3, 0], [2, np.nan], [np.nan, np.nan], [1, -1], [-30, 4], [0, 1.0]])
    yield from flat("run", flt.run(times, z, truth=np.zeros((6, 2))))


def switching():
    """Three modes of one state, two of them not linear."""
    double = text(["x"], ["x - x**3"], [["1"]], [[0.3]])
    middle = text(["x"], ["-2*x"], [["1"]], [[0.6]])
    right = text(["x"], ["1.5*x - x**3 + 0.5"], [["1"]], [[0.6]])
    rates = [[-0.3, 0.2, 0.1], [0.5, -0.6, 0.1], [0.2, 0.2, -0.4]]
    return sf.JumpMarkovModel({"double": double, "middle": middle, "right": right}, rates)


def drifting():
    """Two linear modes of two states with an input."""

    def mode(v):
        A, B = [[0.0, 1.0], [0.0, -0.5]], [[0.0], [1.0]]
        return sf.LinearSDE(A, [0.0, v], noise=[[0.0], [0.4]], B=B)

    return sf.JumpMarkovModel({"rest": mode(0.0), "moving": mode(1.0)}, [[-0.1, 0.1], [0.2, -0.2]])


def shown(prefix, flt):
    """What a filter of modes shows."""
    kept = "t", "x", "P", "x_prior", "P_prior", "x_post", "P_post", "z", "y", "S", "SI", "mahalanobis"
    more = "mode", "mode_probabilities", "log_likelihood", "likelihood", "log_evidence", "dim_x", "dim_z"
    for key in kept + more:
        yield from flat(f"{prefix}.{key}", getattr(flt, key))
    yield f"{prefix}.repr", np.asarray(repr(flt))
    yield from flat(f"{prefix}.inputs", dict(flt.inputs))


@case
def modes():
    level, every = position(1, 0.04), np.arange(1.0, 7.0)
    settings = {"default": {}, "particles": {"n_particles": 80}}
    settings["window"] = {"window": 3, "config": sf.FilterConfig(target_error=0.02)}
    for name, options in settings.items():
        model = switching()
        flt = sf.JumpMarkovFilter(model, level, [0.0], [[0.1]], dt=0.5, **options)
        drawn = sf.simulate_modes(model, level, np.zeros(1), np.r_[0.0, every], rng=3)
        for k, t in enumerate(every, start=1):
            yield from flat(f"{name}.{k}.predict", flt.predict(t=t))
            yield from flat(f"{name}.{k}.update", flt.update(None if k == 3 else drawn.z[k]))
            yield from shown(f"{name}.{k}", flt)
        yield from answers(f"{name}.density", flt.density)
        if "window" in options:
            yield from flat(f"{name}.late", flt.update_late(0.2, flt.t - 1.3))
            yield from shown(f"{name}.late", flt)
    yield from _steered()
    run = sf.JumpMarkovFilter(switching(), level, [0.0], [[0.1]]).run(
        every, drawn.z[1:], truth=drawn.truth[1:]
    )
    yield from flat("run", run)


def _steered():
    """Inputs, several sensors by mode, calls that fail, files."""

    def several(noise):
        one = {"g": position(2, noise), "h": sf.GaussianMeasurement([[0.0, 2.0]], [[noise]])}
        return sf.Sensors(one)

    sensors = {"rest": several(0.1), "moving": several(0.3)}
    flt = sf.JumpMarkovFilter(drifting(), sensors, [0.0, 0.0], 0.1 * np.eye(2), dt=0.5, window=4)
    calls = [
        lambda flt: flt.update({"g": 0.1}),
        lambda flt: flt.predict(u=[0.3]),
        lambda flt: flt.update(0.2, "h"),
        lambda flt: flt.predict(0.0, u={"u0": 0.1}),
        lambda flt: flt.update([np.nan, 0.3], R=0.5),
        lambda flt: flt.predict(-1.0),
        lambda flt: flt.predict(1.0, t=3.0),
        lambda flt: flt.predict(t=1.7),
        lambda flt: flt.update(1.0, position(2, 0.5)),
        lambda flt: setattr(flt, "log_evidence", -1.0),
        lambda flt: flt.update(0.3, sf.LikelihoodMeasurement(lambda z, X, t: -((z[0] - X[:, 0]) ** 2))),
        lambda flt: flt.update(1.0, "k"),
        lambda flt: flt.update_late({"g": 0.4}, 1.1),
        lambda flt: flt.update_late({"g": 0.4}, 9.0),
        lambda flt: flt.predict(0.7),
        lambda flt: flt.update([9.0, np.nan]),
    ]
    for k, call in enumerate(calls):
        try:
            yield from flat(f"steered.{k}.info", call(flt))
        except (sf.SphfilterError, AttributeError) as problem:
            yield f"steered.{k}.problem", np.asarray(str(problem))
        yield from shown(f"steered.{k}", flt)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "modes.npz")
        flt.save(path)
        yield from numbers("steered.file.", path)
        other = sf.JumpMarkovFilter.load(path, drifting(), sensors, window=2)
    yield from shown("steered.loaded", other)
    yield from flat("steered.loaded.predict", other.predict())
    yield from shown("steered.loaded.end", other)
    yield from flat("steered.spread", other.spread())


@case
def transients():
    start = sf.initialize(sf.Gaussian([2.0, 0.0], 0.3 * np.eye(2)), 300)
    every = [0.5, 1.0, 3.0]
    configs = {
        "default": sf.SolverConfig(),
        "paper": sf.SolverConfig(scheme=sf.PaperScheme()),
        "health": sf.SolverConfig(scheme=sf.PaperScheme(), remesh="health"),
        "remesh": sf.SolverConfig(scheme=sf.PaperScheme(), remesh=1.0),
    }
    for name, config in configs.items():
        p = sf.initialize(sf.Gaussian([2.0, 0.0], 0.3 * np.eye(2)), 300, config)
        path = sf.propagate(p, van_der_pol(), every, config)
        for k, (density, info) in enumerate(zip(path.densities, path.infos, strict=True)):
            yield from flat(f"{name}.{k}", info)
            yield from answers(f"{name}.{k}", density)
        yield from questions(name, path.densities[-1])
        yield from flat(f"{name}.health", sf.health(path.densities[-1]))
    with tempfile.TemporaryDirectory() as folder:
        path.save(Path(folder, "path.npz"))
        yield from answers("loaded", sf.Trajectory.load(Path(folder, "path.npz")).densities[-1])
    box = sf.initialize(sf.Uniform([[-1.0, 1.0], [-1.0, 1.0]]), 300, sf.SolverConfig())
    path = sf.propagate(box, van_der_pol(), every, sf.SolverConfig())
    yield from answers("uniform", path.densities[-1])
    for kernel in ("wendland_c2", "cubic"):
        scheme = sf.PaperScheme(kernel=kernel, integrator="rk4")
        try:
            path = sf.propagate(start, van_der_pol(), [0.05], sf.SolverConfig(scheme=scheme))
            yield from answers(kernel, path.densities[-1])
        except sf.SphfilterError as problem:
            yield f"{kernel}.problem", np.asarray(str(problem))
    walls = text(["x", "v"], ["v", "-x - .3*v"], domain=[["reflecting", -3.0, 3.0], "unbounded"])
    try:
        scheme = sf.SolverConfig(scheme=sf.PaperScheme(kernel="wendland_c2"))
        p = sf.initialize(sf.Gaussian([1.0, 0.0], 0.2 * np.eye(2)), 200, scheme, domain=walls.domain)
        yield from answers("walls", sf.propagate(p, walls, [0.1], scheme).densities[-1])
    except sf.SphfilterError as problem:
        yield "walls.problem", np.asarray(str(problem))
    p4 = sf.initialize(sf.Gaussian(np.zeros(4), 0.3 * np.eye(4)), 600)
    yield from answers("cart", sf.propagate(p4, cart(), [0.5, 1.0]).densities[-1])
    again, info = sf.resample(path.densities[-1], 150)
    yield from flat("resampled", info)
    yield from answers("resampled", again)


@case
def inference():
    model, sensor = duffing(), position()
    times = np.arange(0.0, 12.0, 1.0)
    truth, z = sf.simulate(model, sensor, x0=[3.0, 0.0], times=times, rng=4)
    yield from flat("simulated", [truth, z])
    start = {"x0": [3.0, 0.0], "P0": np.diag([0.2, 1.0])}

    def fresh(model=model, n_particles=200):
        return sf.SPHFilter(model, sensor, n_particles=n_particles, **start)

    smoothed = sf.smooth(fresh(), times[1:], z[1:])
    yield from flat("smooth", smoothed)
    line = text(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    ticks = 0.4 * np.arange(1, 31)
    _, y = sf.simulate(line, level, x0=[0.0], times=ticks, rng=3)
    flt = sf.SPHFilter(line, level, x0=[0.0], P0=[[0.1]], n_particles=50)
    fit = sf.fit_parameters(flt, ticks, y, guess={"a": 0.5})
    yield from flat("fit", fit)
    yield from flat("profile", sf.profile_evidence(flt, ticks, y, fit, "a", [0.4, 0.8, 1.2]))
    fit = sf.fit_parameters(fresh(), times[1:], z[1:], guess={"c": 0.5}, max_evaluations=60)
    yield from flat("fit.duffing", fit)
    rivals = {"fitted": fit, "soft": fresh(model.with_parameters(e=0.05))}
    yield from flat("compared", sf.compare_models(rivals, times[1:], z[1:]))


class Scene:
    """A scene of campaigns."""

    name = "duffing"

    def draw(self, rng):
        times = np.arange(1.0, 7.0)
        start = np.array([3.0, 0.0]), np.diag([0.2, 1.0])
        x0 = rng.multivariate_normal(*start)
        truth, z = sf.simulate(duffing(), position(), x0, [0.0, *times], rng)
        return sf.Case(times, truth[1:], z[1:], *start)


@case
def campaigns():
    from reference_filters.kalman import ExtendedKalmanFilter

    def sph(case, rng):
        return sf.SPHFilter(duffing(), position(), case.x0, case.P0, n_particles=150)

    def paper(case, rng):
        return sf.SPHFilter(duffing(), position(), case.x0, case.P0, config=sf.FilterConfig.paper())

    def ekf(case, rng):
        return ExtendedKalmanFilter(duffing(), position(), case.x0, case.P0)

    filters = {"sph": sph, "paper": paper, "ekf": ekf}
    with tempfile.TemporaryDirectory() as folder:
        for n_runs in (3, 5):  # the second call reads what the first has written
            campaign = sf.run_campaign(Scene(), filters, n_runs, seed=2, folder=folder)
            yield from flat(f"campaign.{n_runs}", campaign.results)
    judged = sf.report(campaign, referee="sph")
    yield from flat("report", judged)
    yield "told", np.asarray("\n".join(line for line in str(judged).split("\n") if "time" not in line))
    yield from flat("report.alone", sf.report(campaign.results["sph"], truth=campaign.truth))


@case
def adapters():
    import datetime

    from stonesoup.dataassociator.probability import PDA
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import ConstantVelocity
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track

    from sphfilter.adapters.stonesoup import (
        EvidenceHypothesiser,
        JumpMarkovPredictor,
        JumpMarkovUpdater,
        SPHPredictor,
        SPHUpdater,
    )

    began = datetime.datetime(2026, 1, 1)

    def at(seconds):
        return began + datetime.timedelta(seconds=seconds)

    switches = JumpMarkovPredictor(switching())
    kinds = {
        "duffing": (2, SPHPredictor(duffing(), n_particles=150), SPHUpdater()),
        "line": (2, SPHPredictor(ConstantVelocity(0.4), n_particles=150), SPHUpdater()),
        "switching": (1, switches, JumpMarkovUpdater(switches)),
    }
    for name, (n, predictor, updater) in kinds.items():
        sensor = LinearGaussian(ndim_state=n, mapping=[0], noise_covar=np.array([[0.2]]))
        updater.measurement_model = sensor
        state = GaussianState([3.0, 0.0][:n], np.diag([0.2, 1.0][:n]), timestamp=began)
        for k in range(1, 5):
            predicted = predictor.predict(state, at(k))
            seen = Detection([2.5 - k], timestamp=at(k), measurement_model=sensor)
            state = updater.update(SingleHypothesis(predicted, seen, updater.predict_measurement(predicted)))
            yield from answers(f"{name}.{k}", state.density)
            yield f"{name}.{k}.evidence", np.asarray(state.info.log_evidence)
        hypothesiser = EvidenceHypothesiser(predictor, updater, 0.1, 0.9, prob_gate=1)
        for k in range(5, 8):
            track, seen = Track([state]), [Detection([z], timestamp=at(k)) for z in (2.6 - k, 1.0)]
            hypotheses = PDA(hypothesiser).associate({track}, set(seen), at(k))[track]
            yield f"{name}.{k}.weights", np.sort([float(h.probability) for h in hypotheses])
            state = updater.update(hypotheses)
            yield from answers(f"{name}.{k}", state.density)


@case
def references():
    from reference_filters.grid import GridFilter
    from reference_filters.kalman import ExtendedKalmanFilter, UnscentedKalmanFilter
    from reference_filters.particle import ParticleFilter

    times, start = np.arange(1.0, 9.0), ([3.0, 0.0], np.diag([0.2, 1.0]))
    _, z = sf.simulate(duffing(), position(), [3.0, 0.0], [0.0, *times], 5)
    for make in (ExtendedKalmanFilter, UnscentedKalmanFilter, ParticleFilter, GridFilter):
        options = {"rng": 3} if make is ParticleFilter else {}
        try:
            yield from flat(make.__name__, make(duffing(), position(), *start, **options).run(times, z[1:]))
        except Exception as problem:
            yield f"{make.__name__}.problem", np.asarray(repr(problem))


COMMANDS = [
    "run duffing --runs 2 --seed 3",
    "run benes --runs 1",
    "campaign van_der_pol --runs 3 --filters ekf,ukf,pf,sph --own-prior",
    "sweep duffing --interval 1,2 --q 1 --runs 2 --filters ekf,sph",
    "converge linear_underdamped --counts 50,100 --runs 1",
    "converge van_der_pol --over scheme --counts 100,200 --end 1",
    "transient duffing --no-reference --n-particles 200",
    "transient epidemic --no-reference --n-particles 500",
    "estimate duffing --no-profile --n-particles 100 --set times.end=20",
    "list",
]


@case
def commands():
    """Tables that commands write, less what is the clock's."""
    for line in COMMANDS:
        name, *rest = line.split()
        with tempfile.TemporaryDirectory() as folder:
            out = [] if name == "list" else ["--out", folder]
            done = subprocess.run(
                [sys.executable, "-m", "experiments", name, *rest, *out],
                capture_output=True,
                text=True,
                cwd=ROOT,
                env=os.environ | {"COLUMNS": "120"},
            )
            yield f"{line}.exit", np.asarray(done.returncode)
            if done.returncode:
                yield f"{line}.stderr", np.asarray(done.stderr[-2000:])
            if name == "list":
                yield f"{line}.stdout", np.asarray(done.stdout)
            for path in sorted(Path(folder).rglob("*.csv")):
                yield from table(f"{line}/{path.relative_to(folder)}", path)
            for path in sorted(Path(folder).rglob("*.npz")):
                yield from numbers(f"{line}/{path.relative_to(folder)}", path)


def numbers(prefix, path):
    """Arrays of an npz file by their names, which those of campaigns keep in an index; less the clock's."""
    with np.load(path, allow_pickle=False) as arrays:
        names = {key: key for key in arrays.files}
        if "index" in names:
            names = dict(leaves("", json.loads(str(arrays["index"]))["tree"]))
        for key, name in names.items():
            if not any(word in name for word in CLOCK) and arrays[key].dtype.kind in "fiub":
                yield f"{prefix}{name}", arrays[key]


def leaves(prefix, node):
    """Names of the arrays of a file, and where they stand in its tree."""
    if not isinstance(node, dict):
        yield f"a{node}", prefix
        return
    for key, child in node.items():
        yield from leaves(f"{prefix}/{key}", child)


def table(prefix, path):
    """Columns of a CSV file, less what is the clock's."""
    rows = list(csv.reader(path.open()))
    for k, head in enumerate(rows[0] if rows else []):
        if not any(word in head for word in CLOCK) and head not in ("s", "time/s"):
            column = [row[k] for row in rows[1:] if len(row) > k]
            yield f"{prefix}/{head}", np.asarray(column)


def record(folder, names):
    """Write the numbers of the cases to FOLDER/NAME.npz."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        began = time.perf_counter()
        numbers = {}
        try:
            for key, value in CASES[name]():
                numbers[key] = np.asarray(value)
        except Exception:
            numbers["exception"] = np.asarray(traceback.format_exc(limit=0))
            traceback.print_exc()
        np.savez_compressed(folder / f"{name}.npz", **numbers)
        print(f"{name}: {len(numbers)} values, {time.perf_counter() - began:.0f} s", flush=True)


def compare(one, other):
    """Differences between two recorded folders; the number of them."""
    differ = alike = 0
    for path in sorted(one.glob("*.npz")):
        if not (other / path.name).exists():
            print(f"{path.stem}: not recorded in {other}")
            continue
        a, b = np.load(path), np.load(other / path.name)
        for key in sorted(set(a.files) ^ set(b.files)):
            print(f"{path.stem}: {key} only in {one if key in a.files else other}")
            differ += key in a.files
        for key in a.files:
            if key not in b.files:
                continue
            x, y = a[key], b[key]
            same = (
                x.shape == y.shape
                and x.dtype.kind == y.dtype.kind
                and np.array_equal(x, y, equal_nan=x.dtype.kind in "fc")
            )
            alike += same
            if not same:
                differ += 1
                print(f"{path.stem}: {key}: {_apart(x, y)}")
    print(f"{alike} values alike, {differ} differ")
    return differ


def _apart(x, y):
    if x.shape == y.shape and x.dtype.kind == y.dtype.kind == "f":
        scale = max(np.nanmax(np.abs(x)), 1e-300)
        return f"{np.nanmax(np.abs(x - y)) / scale:.1e} of its largest"
    return f"{str(x)[:150]!r} and {str(y)[:150]!r}"


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", default=",".join(CASES))
    given = parser.parse_args()
    if given.what == "compare":
        return min(compare(*given.folders), 1)
    record(given.folders[0], given.only.split(","))
    return 0


if __name__ == "__main__":
    sys.exit(main())
