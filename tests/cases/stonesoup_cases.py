"""Models, clocks and detections that the tests of the Stone Soup adapter share."""

import datetime

import numpy as np
import pytest
from oscillators import DUFFING

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.base import Property
from stonesoup.buffered_generator import BufferedGenerator
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.reader import DetectionReader
from stonesoup.simulator.simple import SimpleDetectionSimulator, SingleTargetGroundTruthSimulator
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState, State

from sphfilter.adapters.stonesoup import SDETransitionModel

GRID = np.stack(np.meshgrid(*2 * [np.linspace(-9.0, 9.0, 601)], indexing="ij"), axis=-1).reshape(-1, 2)
CELL = (18.0 / 600) ** 2
START = datetime.datetime(2026, 1, 1)


def at(seconds):
    """The time so many seconds after the start."""
    return START + datetime.timedelta(seconds=seconds)


def duffing():
    """A Duffing oscillator with two wells, as text."""
    return DUFFING


def position(variance=0.2):
    """A sensor of the first of two states."""
    return LinearGaussian(ndim_state=2, mapping=[0], noise_covar=np.array([[variance]]))


def gaussian(mean=(3.0, 0.0), variances=(0.2, 1.0), seconds=0.0):
    return GaussianState(list(mean), np.diag(variances), timestamp=at(seconds))


def seen(*z, seconds, model=None):
    """A detection of the values z."""
    return Detection(list(z), timestamp=at(seconds), measurement_model=model)


def off(state, mean, cov):
    """Errors of a state's mean and covariance, in standard deviations."""
    scale = np.sqrt(np.diag(cov))
    d_mean = (np.asarray(state.mean, dtype=float).ravel() - mean) / scale
    d_cov = (np.asarray(state.covar, dtype=float) - cov) / np.outer(scale, scale)
    return np.abs(d_mean).max(), np.abs(d_cov).max()


def on_grid(density, likelihood):
    """Evidence, mean and covariance of density times likelihood, summed over a grid."""
    p = density.pdf(GRID) * CELL * likelihood
    mean = p @ GRID / p.sum()
    d = GRID - mean
    return p.sum(), mean, (d * p[:, None]).T @ d / p.sum()


def failing(*arguments, **options):
    """What stands in a test for a step of the library that cannot be made."""
    raise sf.PropagationError("nothing holds it")


class Recorded(DetectionReader):
    """Detections that were recorded: scans of (time, detections), the same for every tracker."""

    scans: list = Property()

    @BufferedGenerator.generator_method
    def detections_gen(self):
        yield from ((time, set(detections)) for time, detections in self.scans)


def recorded_scene(seed, n_scans=40, prob_detect=0.9, clutter_rate=6.0):
    """An oscillator seen through Stone Soup's simulators, with clutter and misses.

    Returns
    -------
    scans : list of (datetime, set of Detection)
        The first holds a detection of the target alone.
    truth : ndarray, shape (n_scans, 2)
    clutter : float
        Spatial density of the clutter.
    """
    target = SingleTargetGroundTruthSimulator(
        SDETransitionModel(duffing(), seed=seed), State([3.0, 0.0], START), at(1) - START, n_scans
    )
    sensor = LinearGaussian(ndim_state=2, mapping=[0, 1], noise_covar=np.diag([0.2, 4.0]), seed=seed)
    region = np.array([[-8.0, 8.0], [-8.0, 8.0]])
    simulator = SimpleDetectionSimulator(target, sensor, region, prob_detect, clutter_rate, seed=seed)
    scans, truth = [], []
    for time, detections in simulator:
        scans.append((time, set(detections)))
        truth.append(np.ravel(next(iter(target.groundtruth_paths)).state_vector))
    scans[0] = scans[0][0], {Detection(truth[0] + [0.1, 0.3], timestamp=START, measurement_model=sensor)}
    return scans, np.array(truth), simulator.clutter_spatial_density
