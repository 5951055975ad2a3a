"""What a typical user writes, as a strict type checker reads it (`test_typed.py`); it runs, too."""

from collections.abc import Mapping
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import sphfilter as sf

Floats = NDArray[np.float64]
TIMES = 0.4 * np.arange(1, 13)


def oscillator(x: Floats, t: float, p: Floats) -> tuple[float, float]:
    return x[1], -p[0] * x[1] - x[0]


def models() -> tuple[sf.SDE, sf.GaussianMeasurement]:
    """A model as a function and as text, and sensors of every kind."""
    swing = sf.SDE(oscillator, dim=2, noise=[[0.0], [1.0]], parameters={"damping": 0.5})
    assert_type(swing.with_parameters(damping=1.0).drift([[0.0, 2.0]], t=0.0), Floats)
    turn = sf.SDE.from_expressions(["a"], ["1"], [["0.1"]], domain=[("periodic", -np.pi, np.pi)])
    assert_type(turn.domain.period, Floats)
    assert_type(sf.LinearSDE([[-1.0]], noise=[[1.0]]).discretize(0.1), tuple[Floats, Floats, Floats])
    distance = sf.GaussianMeasurement(h=lambda x: (x[0] ** 2 + x[1] ** 2,), noise_cov=[[0.1]])
    assert_type(distance.log_likelihood([25.0], [[3.0, 4.0]]), Floats)
    counter = sf.LikelihoodMeasurement(lambda z, X, t: z[0] * X[:, 0] - np.exp(X[:, 0]))
    assert_type(counter.observed(None), NDArray[np.bool_])
    decay = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    level = sf.GaussianMeasurement.from_expressions(["x"], ["x"], noise_cov=[[0.1]])
    return decay, level


def driven() -> sf.UpdateInfo:
    """Inputs, tables, several sensors, and a reading that comes late."""
    table = sf.Table([0.0, 1.0], [0.0, 2.0], kind="previous")
    cart = sf.SDE.from_expressions(
        ["v"], ["a - table('drag', v)"], [["0.3"]], inputs=["a"], tables={"drag": table}
    )
    assert_type(cart.with_inputs({"a": 1.0}).p, Floats)
    meter = sf.GaussianMeasurement.from_expressions(["v"], ["v"], [["s*(1 + v**2)"]], parameters={"s": 0.1})
    both = sf.Sensors(
        {"meter": meter.with_parameters(s=0.2), "other": sf.GaussianMeasurement([[1.0]], [[0.1]])}
    )
    times, z = both.merged({"meter": ([0.5, 1.0], [0.1, 0.2])})
    assert_type(z, Floats)
    flt = sf.SPHFilter(cart, both, x0=[0.0], P0=[[0.1]], window=4)
    assert_type(flt.run(times, z, inputs={"a": [0.0, 1.0]}), sf.FilterResult)
    flt.predict(0.5, u=[1.0])
    flt.update({"meter": 0.3, "other": None})
    flt.update(0.4, "other")
    return flt.update_late(0.3, 1.2, "meter")


def settings() -> sf.FilterConfig:
    """Settings, to a file and back."""
    config = sf.FilterConfig(target_error=0.01, scheme=sf.LogDensityScheme(reach=5.0))
    assert_type(sf.FilterConfig.from_toml(config.to_toml()), sf.FilterConfig)
    assert_type(sf.FilterConfig.paper(kernel="gaussian").acceptance, sf.AcceptanceTest)
    assert_type(sf.FilterConfig(scheme="paper").time_budget, float | None)
    assert_type(sf.SolverConfig(scheme="paper", remesh=2.0).exact_linear, bool)
    return config


def filtering(model: sf.SDE, sensor: sf.GaussianMeasurement, config: sf.FilterConfig) -> Floats:
    """Step by step, and a whole record at once."""
    truth, z = sf.simulate(model, sensor, x0=[0.0], times=TIMES, rng=3)
    flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[0.1]], n_particles=50, config=config)
    for t, zt in zip(TIMES, z, strict=True):
        predicted = flt.predict(t=t)
        assert_type(predicted, sf.PredictInfo)
        assert_type(predicted.status, str)
        updated = flt.update(zt)
        assert_type(updated, sf.UpdateInfo)
        assert_type(updated.log_evidence, float)
        assert_type(updated.innovation, Floats | None)
    assert_type(flt.update(None, R=0.2).accepted, bool)
    assert_type(flt.x, Floats)
    assert_type(flt.P_prior, Floats)
    assert_type(flt.t, float)
    assert_type(flt.log_evidence, float)
    assert_type(flt.density, sf.ParticleDensity)
    result = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[0.1]], dt=0.4).run(TIMES, z, truth=truth)
    assert_type(result, sf.FilterResult)
    assert_type(result.innovation, Floats)
    assert_type(sf.consistency.nees(truth, result.x, result.P), Floats)
    assert_type(sf.consistency.nees_bounds(dim=1, n_runs=25), tuple[float, float])
    assert_type(sf.report(result, truth=truth).filters["filter"].verdict, str)
    return z


def density() -> sf.ParticleDensity:
    """What a density is asked."""
    p = sf.initialize(sf.Gaussian([1.0, 0.0], np.eye(2)), n_particles=200)
    assert_type(p.mean(), Floats)
    assert_type(p.cov(), Floats)
    assert_type(p.pdf([0.0, 0.0]), Floats)
    assert_type(p.sample(5, rng=1), Floats)
    assert_type(p.mode(), Floats)
    assert_type(p.probability(lambda X: X[:, 0] > 0), float)
    assert_type(p.entropy(), float)
    assert_type(p.quantile(0, [0.05, 0.95]), Floats)
    assert_type(p.marginal([0]), sf.ParticleDensity)
    assert_type(p.hpd_region(0.95)([[0.0, 0.0]]), NDArray[np.bool_])
    assert_type(p.hpd_region(0.95).volume, float)
    assert_type(sf.health(p).complaint, str)
    fewer, info = sf.resample(p, 100)
    assert_type(info, sf.ResampleInfo)
    return fewer


def transient(start: sf.ParticleDensity) -> None:
    """The functions below the filter: densities in, densities and infos out."""
    swing = sf.SDE.from_expressions(["x", "v"], ["v", "-x - 0.5*v"], [["0"], ["1"]])
    moved, predicted = sf.predict(start, swing, 0.5)
    assert_type(moved, sf.ParticleDensity)
    assert_type(predicted.bypass_ratio, float)
    posterior, updated = sf.update(moved, sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]]), [0.3])
    assert_type(posterior, sf.ParticleDensity)
    assert_type(updated.reason, str)
    path = sf.propagate(start, swing, [0.0, 0.5, 1.0])
    assert_type(path, sf.Trajectory)


def inference(model: sf.SDE, sensor: sf.GaussianMeasurement, z: Floats) -> None:
    """Parameters, models and smoothed densities of a record."""
    flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[0.1]], n_particles=50)

    def build(parameters: Mapping[str, float]) -> sf.SPHFilter:
        louder = sensor.changed(noise_cov=parameters["R"])
        return sf.SPHFilter(model, louder, x0=[0.0], P0=[[0.1]], n_particles=50)

    fit = sf.fit_parameters(build, TIMES, z, guess={"R": 0.1}, bounds={"R": (0.01, None)})
    assert_type(fit.estimate["R"], float)
    assert_type(sf.profile_evidence(build, TIMES, z, fit, "R", [0.1, 0.2]), Floats)
    compared = sf.compare_models({"fitted": fit, "as given": flt}, TIMES, z)
    assert_type(compared.words, tuple[str, ...])
    smoothed = sf.smooth(flt, TIMES, z)
    assert_type(smoothed.densities[3].quantile(0, 0.5), float)
    assert_type(smoothed.filtered.x, Floats)


class Decay:
    """A scenario of a user's own."""

    name = "decay"

    def __init__(self, model: sf.SDE, sensor: sf.GaussianMeasurement) -> None:
        self.model, self.sensor = model, sensor

    def draw(self, rng: np.random.Generator) -> sf.Case:
        truth, z = sf.simulate(self.model, self.sensor, rng.normal(size=1), [0.0, *TIMES], rng)
        return sf.Case(TIMES, truth[1:], z[1:], x0=[0.0], P0=[[1.0]])


def campaign(model: sf.SDE, sensor: sf.GaussianMeasurement) -> None:
    """Many runs, and what they say."""

    def sph(case: sf.Case, rng: np.random.Generator) -> sf.SPHFilter:
        return sf.SPHFilter(model, sensor, case.x0, case.P0, n_particles=60)

    found = sf.run_campaign(Decay(model, sensor), {"sph": sph}, n_runs=2, seed=1)
    assert_type(found, sf.CampaignResult)
    assert_type(found.results["sph"].P, Floats)
    assert_type(found.failures[0].message if found.failures else "", str)
    assert_type(sf.report(found).filters["sph"].ranks.pit, Floats)


if __name__ == "__main__":
    driven()
    model, sensor = models()
    z = filtering(model, sensor, settings())
    transient(density())
    inference(model, sensor, z)
    campaign(model, sensor)
