"""Grid in a fixed box against exact filters, its own order, and the adaptive grid."""

from types import SimpleNamespace

import numpy as np
import pytest
from referee_cases import OSCILLATOR, P0, POSITION, X0, errors

from reference_filters.boxed_grid import BoxedGridFilter, box_of_case
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE

BOX = [[-8.0, 8.0], [-9.0, 8.0]]
TIMES, READINGS = [0.0, 0.8, 0.8, 2.0, 4.5], [[1.5], [0.4], [3.0], None, [-1.9]]


def test_order_two_on_a_linear_oscillator():
    """Irregular and repeated times and a missing reading; the second model exchanges the states."""
    truth = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(TIMES, READINGS)
    swapped = LinearSDE(A=[[-0.2, -1.0], [1.0, 0.0]], noise=[[1.0], [0.0]], spectral_density=[[0.8]])
    second = GaussianMeasurement(h=[[0.0, 1.0]], noise_cov=[[0.4]])
    off = []
    for step in (0.2, 0.1, 0.05):
        filt = BoxedGridFilter(OSCILLATOR, POSITION, X0, P0, box=BOX, size=56, step=step)
        off.append(max(errors(filt.run(TIMES, READINGS), truth)))
        assert filt.probabilities.sum() == pytest.approx(1.0)
        other = BoxedGridFilter(swapped, second, X0[::-1], P0[::-1, ::-1], box=BOX[::-1], size=56, step=step)
        turned = _reversed(other.run(TIMES, READINGS))
        assert max(errors(turned, truth)) == pytest.approx(off[-1], rel=1e-4)
    orders = np.log2(np.array(off[:-1]) / off[1:])
    assert np.all((orders > 1.8) & (orders < 2.2)), off
    assert off[-1] < 1e-3


def _reversed(result):
    return SimpleNamespace(x=result.x[:, ::-1], P=result.P[:, ::-1, ::-1], log_evidence=result.log_evidence)


def test_one_dimension():
    model = LinearSDE(A=[[-0.7]], b=[0.4], noise=[[1.0]], spectral_density=[[0.5]])
    sensor = GaussianMeasurement(h=[[2.0]], noise_cov=[[0.3]])
    times, readings = [0.5, 1.7], [[1.0], [-0.4]]
    truth = KalmanFilter(model, sensor, [0.2], [[0.6]]).run(times, readings)
    filt = BoxedGridFilter(model, sensor, [0.2], [[0.6]], box=[[-5.0, 5.5]], size=64, step=0.01)
    assert max(errors(filt.run(times, readings), truth)) < 1e-4


def test_nonlinear_model_with_noise_in_both_states_against_the_adaptive_grid():
    model = SDE(lambda x: (x[1] - 0.3 * np.sin(x[0]), x[0] - 0.1 * x[0] ** 3 - 0.4 * x[1]), 2,
                [[0.5, 0.0], [0.0, 1.0]], [[0.4, 0.0], [0.0, 1.2]])  # fmt: skip
    times, z = np.array([1.0, 2.2]), np.array([[0.8], [-0.3]])
    truth = GridFilter(model, POSITION, X0, P0, size=80, tol=5e-4).run(times, z)
    box = box_of_case(model, POSITION, SimpleNamespace(times=times, z=z, x0=X0, P0=P0, t0=0.0))
    result = BoxedGridFilter(model, POSITION, X0, P0, box=box, size=64, step=0.02).run(times, z)
    assert max(errors(result, truth)) < 1e-3


def test_box_of_case_holds_what_lies_between_the_measurements():
    """Half a turn carries the mean from 3 to -3 between two measurements at zero."""
    turn = LinearSDE(A=[[0.0, 1.0], [-1.0, 0.0]], noise=[[0.0], [1.0]], spectral_density=[[0.01]])
    case = SimpleNamespace(times=[np.pi], z=[[0.0]], x0=np.array([0.0, 3.0]), P0=0.01 * np.eye(2), t0=0.0)
    box = box_of_case(turn, POSITION, case)
    assert box[0, 1] > 3.3
    assert box[1, 0] < -3.3


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (LinearSDE(A=-np.eye(3), noise=np.eye(3)), "takes 1 or 2 states"),
        (SDE(lambda x, t: (x[1], -x[0] * t), 2, [[0.0], [1.0]]), "without time"),
        (SDE(lambda x: (x[1], -x[0]), 2, [[1.0], [1.0]]), "noise of its own"),
        (SDE(lambda x: (x[1], -x[0]), 2, lambda x: ((0.0,), (x[0],)), [[1.0]]), "constant noise"),
    ],
)
def test_models_that_it_does_not_take(model, says):
    with pytest.raises(ModelError, match=says):
        BoxedGridFilter(model, POSITION, np.zeros(model.dim), np.eye(model.dim), box=BOX)


def test_a_box_beside_the_density_is_told():
    with pytest.raises(ModelError, match="lies outside of the box"):
        BoxedGridFilter(OSCILLATOR, POSITION, [500.0, 0.0], P0, box=BOX)
    with pytest.raises(ModelError, match="low, high"):
        BoxedGridFilter(OSCILLATOR, POSITION, X0, P0, box=[[1.0, 1.0], [0.0, 2.0]])


def test_an_impossible_measurement_is_told():
    never = LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf), dim_z=1)
    filt = BoxedGridFilter(OSCILLATOR, never, X0, P0, box=BOX)
    with pytest.raises(PropagationError, match="no density"):
        filt.update([0.0])
