"""Models compared by evidence: the right one wins, on the same data only, rejected measurements counted."""

from types import SimpleNamespace

import numpy as np
import pytest
from density_cases import text
from oscillators import DUFFING, OSCILLATOR, POSITION, START, TIMES, exact, readings

import sphfilter as sf
from reference_filters.kalman import KalmanFilter

CLOUD = sf.FilterConfig(scheme=sf.CloudScheme(n_points=1024))


@pytest.fixture(scope="module")
def z():
    return readings(OSCILLATOR, TIMES, START[0], 2)


def test_the_right_model_wins():
    """Duffing against the best linear oscillator, on data drawn from the one and from the other."""
    start = np.array([3.0, 0.0]), np.diag([0.2, 1.0])
    times = 2.0 * np.arange(1, 26)
    linear = text(["x", "v"], ["v", "-c*v - k*x"], Q=[[1.6]], c=0.4, k=1.0)

    def of_linear(p):
        return KalmanFilter(linear.with_parameters(**p), POSITION, *start)

    for truth, winner in ((DUFFING, "Duffing"), (linear, "linear")):
        z = readings(truth, times, start[0], 5)
        z[3] = np.nan
        fit = sf.fit_parameters(of_linear, times, z, {"c": 0.5, "k": 0.8}, bounds={"c": (0.0, None)})
        duffing = sf.SPHFilter(DUFFING, POSITION, *start)
        found = sf.compare_models({"linear": fit, "Duffing": duffing}, times, z)
        assert found.names[0] == winner and found.words == ("the best", "very strong")
        assert found.n_readings == 24 and duffing.t == 0.0
        k = found.names.index("linear")
        assert found.bic[k] == pytest.approx(fit.bic) and found.aic[k] == pytest.approx(fit.aic)
        assert found.log_bayes_factor[1] == pytest.approx(-0.5 * abs(np.diff(found.bic)[0]))
        assert list(found.as_dict()["models"]) == list(found.names)
        assert winner in str(found).splitlines()[1]


def test_rejected_measurements_count(z):
    """A model whose filter rejects a measurement does not win by that."""
    wild = np.array(z[:6])
    wild[3] = 200.0
    times = TIMES[:6]
    narrow = sf.SPHFilter(OSCILLATOR, POSITION, *START, n_particles=200)
    wide = sf.SPHFilter(OSCILLATOR, POSITION.changed(noise_cov=1e4), *START, n_particles=200)
    found = sf.compare_models({"narrow": narrow, "wide": wide}, times, wild)
    assert found.names == ("wide", "narrow") and list(found.n_rejected) == [0, 1]


def test_errors_of_the_evidence_are_told(z):
    """A cloud is off by what it tells, at 24 clocks; Kalman's filter is exact; a fit tells its own."""
    kalman = sf.compare_models({"exact": exact({})}, TIMES, z)
    assert kalman.evidence_error[0] == 0.0
    off, told = [], []
    for t0 in range(24):
        cloud = sf.SPHFilter(OSCILLATOR, POSITION, *START, t0=float(t0), config=CLOUD)
        found = sf.compare_models({"cloud": cloud}, TIMES + t0, z)
        off.append(found.log_evidence[0] - kalman.log_evidence[0])
        told.append(found.evidence_error[0])
    assert 1 / 3 < np.sqrt(np.mean(np.square(told)) / np.mean(np.square(off))) < 3
    few = sf.SPHFilter(OSCILLATOR, POSITION, *START, n_particles=60)
    fit = sf.fit_parameters(few, TIMES, z, {"k": 0.8})
    assert fit.evidence_error == fit.result.total_evidence_error < 0.01
    assert f"± {fit.evidence_error:.1g} nat" in str(fit)


def test_a_filter_of_ones_own_need_not_tell_errors(z):
    """Nor has its result to be one of the library's."""

    class Own:
        def run(self, times, measurements):
            return SimpleNamespace(log_evidence=-np.ones(len(times)), accepted=np.ones(len(times), bool))

    found = sf.compare_models({"own": Own(), "exact": exact({})}, TIMES, z)
    assert np.isnan(found.evidence_error[found.names.index("own")]) and "nan" in str(found)


def test_models_are_compared_on_the_same_data_only(z):
    fit = sf.fit_parameters(exact, TIMES, z, {"k": 0.8})
    with pytest.raises(sf.ModelError, match="fitted to other measurements"):
        sf.compare_models({"a": fit}, TIMES[:-1], z[:-1])
    with pytest.raises(sf.ModelError, match="must be a filter or a ParameterFit"):
        sf.compare_models({"a": 3.0}, TIMES, z)
    with pytest.raises(sf.ModelError, match="no model"):
        sf.compare_models({}, TIMES, z)
    missing = [row if k else None for k, row in enumerate(z)]
    first = np.vstack([[[np.nan]], z[1:]])
    twice = sf.fit_parameters(exact, TIMES, missing, {"k": 0.8})
    assert sf.compare_models({"a": twice}, TIMES, first).log_evidence[0] == twice.log_evidence
