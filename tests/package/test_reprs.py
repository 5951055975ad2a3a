"""What public results say of themselves where a user prints them: one line, however long the record."""

import numpy as np
import pytest

import sphfilter as sf

MODEL = sf.LinearSDE(-np.eye(3), noise=np.eye(3))
SENSOR = sf.GaussianMeasurement(np.eye(3), np.eye(3))
TIMES = 0.5 * np.arange(1, 13)
TRUTH, Z = sf.simulate(MODEL, SENSOR, np.zeros(3), TIMES, rng=1)
CASE = sf.Case(TIMES, TRUTH, Z, np.zeros(3), np.eye(3))


class Decay:
    """A scenario of one case."""

    name = "decay"
    draw = staticmethod(lambda rng: CASE)


def filtering(case=CASE, rng=None):
    return sf.SPHFilter(MODEL, SENSOR, case.x0, case.P0, n_particles=200)


@pytest.fixture(scope="module")
def results():
    """Every public class of results, with arrays of more than a line."""
    flt = filtering()
    campaign = sf.run_campaign(Decay(), {"sph": filtering}, n_runs=2, seed=1)
    numbers = sf.report(campaign)
    return {
        "CampaignResult": campaign,
        "Case": CASE,
        "FilterResult": filtering().run(TIMES, Z, truth=TRUTH),
        "FilterReport": numbers.filters["sph"],
        "Gaussian": sf.Gaussian(np.zeros(8), np.eye(8)),
        "Health": sf.health(flt.density),
        "ModelComparison": sf.compare_models({"one": filtering(), "other": filtering()}, TIMES, Z),
        "ParticleDensity": flt.density,
        "PredictInfo": flt.predict(0.5),
        "Ranks": numbers.filters["sph"].ranks,
        "Report": numbers,
        "ResampleInfo": sf.resample(flt.density, 100)[1],
        "SPHFilter": flt,
        "Trajectory": sf.propagate(flt.density, MODEL, flt.t + TIMES[:3]),
        "Uniform": sf.Uniform(8 * [[0.0, 1.0]]),
        "UpdateInfo": flt.update(Z[0]),
        "WeightedStates": flt.spread(),
    }


def test_one_line_each(results):
    for name, result in results.items():
        text = repr(result)
        assert text.startswith(f"{name}("), text
        assert "\n" not in text and len(text) < 2000, text
    assert "2 runs of 12 epochs of 3 states, seed 1: sph; 0 failures" in str(results["CampaignResult"])
    assert "innovation_cov=array of shape" not in repr(results["UpdateInfo"])
    assert "cov=array of shape (8, 8)" in repr(results["Gaussian"])
    assert repr(results["Trajectory"]) == "Trajectory(3 densities, t = 1 to 2)"


def test_fits_and_smoothed_records_too():
    model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    flt = sf.SPHFilter(model, sf.GaussianMeasurement([[1.0]], [[0.1]]), [0.0], [[0.1]], n_particles=50)
    fit = sf.fit_parameters(flt, TIMES, Z[:, :1], guess={"a": 0.5})
    assert repr(fit).startswith("ParameterFit(a = ") and "\n" not in repr(fit)
    smoothed = sf.smooth(flt, TIMES, Z[:, :1])
    assert str(smoothed) == (
        "SmoothedResult(12 epochs of 1 states: t, x, P, densities, filtered, log_evidence, extrapolated, "
        "error, variance_error, flagged)"
    )
