"""The filter in Stone Soup: predictor, updater, hypothesiser and states that carry a density.

Needs the extra: ``pip install "sphfilter[stonesoup]"``. The classes take the places of Stone Soup's own, so
that its gates, data associators, initiators, deleters and trackers work on densities:

>>> import datetime, numpy as np, sphfilter as sf
>>> from stonesoup.dataassociator.probability import PDA
>>> from stonesoup.models.measurement.linear import LinearGaussian
>>> from stonesoup.types.detection import Detection
>>> from stonesoup.types.state import GaussianState
>>> from stonesoup.types.track import Track
>>> from sphfilter.adapters.stonesoup import EvidenceHypothesiser, SPHPredictor, SPHUpdater
>>> duffing = sf.SDE.from_expressions(
...     ["x", "v"], ["v", "x - 0.4*v - 0.1*x**3"], noise=[["0"], ["1"]], spectral_density=[[1.6]])
>>> predictor = SPHPredictor(duffing, n_particles=200)
>>> updater = SPHUpdater(LinearGaussian(ndim_state=2, mapping=[0], noise_covar=np.array([[0.2]])))
>>> associator = PDA(EvidenceHypothesiser(predictor, updater, clutter_spatial_density=0.05, prob_detect=0.9))
>>> start = datetime.datetime(2026, 1, 1)
>>> track = Track([GaussianState([3.0, 0.0], np.diag([0.2, 1.0]), timestamp=start)])
>>> time = start + datetime.timedelta(seconds=1)
>>> detections = {Detection([2.6], timestamp=time), Detection([-1.0], timestamp=time)}  # one is clutter
>>> track.append(updater.update(associator.associate({track}, detections, time)[track]))
>>> track.state.density.probability(lambda X: X[:, 0] < 0) < 0.02
True

`SDETransitionModel` is the way of an equation to Stone Soup's simulators and other filters; of its own
models `linear_sde` turns ConstantVelocity, OrnsteinUhlenbeck, Singer and their combinations into equations,
and refuses those that are none. Detections bring their measurement_model along or take the updater's.

`SingleTargetTracker` keeps densities through PDA and JPDA: the posterior of several detections is one
density, not a Gaussian of its moments. Stone Soup's mixture trackers merge into Gaussians themselves, and the
predictor goes on from those. Detections associated together need one timestamp.

`JumpMarkovPredictor` and `JumpMarkovUpdater` carry a density for every mode of a `JumpMarkovModel`, and sum
associations in each of them. States tell `mode`, `mode_probabilities` and `densities`:

>>> from sphfilter.adapters.stonesoup import JumpMarkovPredictor, JumpMarkovUpdater
>>> drift = lambda v: sf.LinearSDE([[0.0]], [v], noise=[[0.2]])
>>> model = sf.JumpMarkovModel({"rest": drift(0.0), "moving": drift(1.0)}, [[-0.1, 0.1], [0.2, -0.2]])
>>> predictor = JumpMarkovPredictor(model)
>>> updater = JumpMarkovUpdater(predictor, sf.GaussianMeasurement([[1.0]], [[0.04]]))
>>> associator = PDA(EvidenceHypothesiser(predictor, updater, clutter_spatial_density=0.05, prob_detect=0.9))
>>> track = Track([GaussianState([0.0], [[0.1]], timestamp=start)])
>>> detections = {Detection([1.1], timestamp=time), Detection([-4.0], timestamp=time)}
>>> track.append(updater.update(associator.associate({track}, detections, time)[track]))
>>> print(track.state.mode, track.state.mode_probabilities.round(2))
moving [0.15 0.85]

A call that fails raises `ModelError` or `PropagationError` with a sentence, and leaves track and states as
they were. `info` of predictions and updates says how they went. `notebooks/stone_soup.ipynb` shows a tracker.

Plotters draw the mean of a state; `SPHState.to_particle_state` makes the states whose points they draw with
``plot_tracks({Track([state.to_particle_state(200) for state in track])}, [0, 1], particle=True)``.

Objects pickle. `stonesoup.serialise.YAML` writes and reads states, predictors and updaters, densities as
arrays and models as their text; a model that is a Python function is refused with a sentence, and so
are models that switch and their states. Where the package is not installed but on the path, `extend(yaml)`
teaches a YAML object their classes.
"""

import sys

try:
    import stonesoup.base  # noqa: F401
except ImportError as missing:
    raise ImportError(
        'sphfilter.adapters.stonesoup needs Stone Soup: pip install "sphfilter[stonesoup]"'
    ) from missing

from .hypothesiser import EvidenceHypothesiser
from .predictor import JumpMarkovPredictor, SPHPredictor
from .serialise import extend
from .states import (
    JumpMarkovState,
    JumpMarkovStatePrediction,
    JumpMarkovStateUpdate,
    SPHState,
    SPHStatePrediction,
    SPHStateUpdate,
)
from .transition import SDETransitionModel, linear_sde
from .updater import JumpMarkovUpdater, SPHUpdater

__all__ = [
    "EvidenceHypothesiser",
    "JumpMarkovPredictor",
    "JumpMarkovState",
    "JumpMarkovStatePrediction",
    "JumpMarkovStateUpdate",
    "JumpMarkovUpdater",
    "SDETransitionModel",
    "SPHPredictor",
    "SPHState",
    "SPHStatePrediction",
    "SPHStateUpdate",
    "SPHUpdater",
    "extend",
    "linear_sde",
]

# where pickles of before look for the classes of models that switch
for _part in ("predictor", "states", "updater"):
    sys.modules[f"{__name__}.jump_markov_{_part}"] = sys.modules[f"{__name__}.{_part}"]
