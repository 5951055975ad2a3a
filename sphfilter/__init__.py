"""Bayes filters that carry the probability density itself, solved with smoothed particle hydrodynamics.

The rooms, from what is given to what is made of it; each imports only from those before it:

core         compiled: kernel sums (sph), log-densities on lattices (field, characteristics), one
             exponential family (family), clouds of weighted points (cloud)
model        equations, modes they switch between, sensors, tables, where states live, simulated truths
lattice      where particles lie
density      what a filter carries: particles, points, a family or a few, Gaussian pieces; how it is stored
prediction   how it is carried, a file a scheme; beside it consistency: is a filter as good as it says?
filter       Bayes' rule and the loop, of one model or of modes
inference    whole records; beside it campaign, many runs, adapters, other toolkits, and files, of users
command      the commands of `sphfilter --help`

Beside the rooms: config and settings, info of steps, errors and validate. API.md has every public name in a
line, RECIPES.md what to write for a problem, FAILURES.md what failures say, EXTENDING.md how to add to it.
"""

from .command import interruption as _interruption  # noqa: F401  # first: it answers Ctrl-C in what follows

# isort: split

from . import consistency
from ._version import __version__
from .ahead import compile
from .campaign.campaign import CampaignResult, run_campaign
from .campaign.one_run import Case
from .campaign.report import Report, report
from .config import (
    AcceptanceTest,
    CloudScheme,
    FamilyScheme,
    FilterConfig,
    LogDensityScheme,
    PaperScheme,
    SolverConfig,
)
from .density.distributions import Gaussian, Uniform
from .density.health import Health, health
from .density.initialize import initialize
from .density.particle_density import ParticleDensity
from .density.resample import resample
from .errors import (
    ConfigError,
    EstimationError,
    ExpressionError,
    ModelError,
    PropagationError,
    SphfilterError,
)
from .files.read_model import ModelOfFile, read_model
from .filter.forecast import Forecast
from .filter.jump_markov_filter import JumpMarkovFilter, JumpMarkovResult
from .filter.results import FilterResult
from .filter.sph_filter import SPHFilter
from .filter.update import update
from .inference.estimation import ParameterFit, fit_parameters, profile_evidence
from .inference.model_comparison import ModelComparison, compare_models
from .inference.posterior import ParameterPosterior
from .inference.smoother import SmoothedResult, smooth
from .info import Code, PredictInfo, ResampleInfo, UpdateInfo
from .model.correlated import correlated_noise
from .model.discrete import DiscreteModel
from .model.domain import Domain
from .model.jump_markov import JumpMarkovModel
from .model.likelihood import LikelihoodMeasurement
from .model.measurements import GaussianMeasurement
from .model.sde import SDE, LinearSDE
from .model.sensors import Sensors
from .model.simulate import simulate, simulate_modes
from .model.tables import Table
from .prediction.predict import predict
from .prediction.propagate import Trajectory, propagate

__all__ = [
    "SDE",
    "AcceptanceTest",
    "CampaignResult",
    "Case",
    "CloudScheme",
    "Code",
    "ConfigError",
    "DiscreteModel",
    "Domain",
    "EstimationError",
    "ExpressionError",
    "FamilyScheme",
    "FilterConfig",
    "FilterResult",
    "Forecast",
    "Gaussian",
    "GaussianMeasurement",
    "Health",
    "JumpMarkovFilter",
    "JumpMarkovModel",
    "JumpMarkovResult",
    "LikelihoodMeasurement",
    "LinearSDE",
    "LogDensityScheme",
    "ModelComparison",
    "ModelError",
    "ModelOfFile",
    "PaperScheme",
    "ParameterFit",
    "ParameterPosterior",
    "ParticleDensity",
    "PredictInfo",
    "PropagationError",
    "Report",
    "ResampleInfo",
    "SPHFilter",
    "Sensors",
    "SmoothedResult",
    "SolverConfig",
    "SphfilterError",
    "Table",
    "Trajectory",
    "Uniform",
    "UpdateInfo",
    "__version__",
    "compare_models",
    "compile",
    "consistency",
    "correlated_noise",
    "fit_parameters",
    "health",
    "initialize",
    "predict",
    "profile_evidence",
    "propagate",
    "read_model",
    "report",
    "resample",
    "run_campaign",
    "simulate",
    "simulate_modes",
    "smooth",
    "update",
]
