"""Bayes filters that carry the probability density itself, solved with smoothed particle hydrodynamics."""

from . import consistency
from ._version import __version__
from .campaign import CampaignResult, Case, run_campaign
from .config import (
    AcceptanceTest,
    CorrectedScheme,
    FilterConfig,
    LogDensityScheme,
    PaperScheme,
    SolverConfig,
)
from .density import ParticleDensity
from .domain import Domain
from .errors import (
    ConfigError,
    EstimationError,
    ExpressionError,
    ModelError,
    PropagationError,
    SphfilterError,
)
from .estimation import ParameterFit, fit_parameters, profile_evidence
from .filter import SPHFilter
from .health import Health, health
from .info import PredictInfo, ResampleInfo, UpdateInfo
from .initial import Gaussian, Uniform, initialize
from .measurements import GaussianMeasurement, LikelihoodMeasurement
from .model_comparison import ModelComparison, compare_models
from .models import SDE, LinearSDE
from .predict import predict
from .report import Report, report
from .resample import resample
from .results import FilterResult
from .simulate import simulate
from .smoother import SmoothedResult, smooth
from .transient import Trajectory, propagate
from .update import update

__all__ = [
    "SDE",
    "AcceptanceTest",
    "CampaignResult",
    "Case",
    "ConfigError",
    "CorrectedScheme",
    "Domain",
    "EstimationError",
    "ExpressionError",
    "FilterConfig",
    "FilterResult",
    "Gaussian",
    "GaussianMeasurement",
    "Health",
    "LikelihoodMeasurement",
    "LinearSDE",
    "LogDensityScheme",
    "ModelComparison",
    "ModelError",
    "PaperScheme",
    "ParameterFit",
    "ParticleDensity",
    "PredictInfo",
    "PropagationError",
    "Report",
    "ResampleInfo",
    "SPHFilter",
    "SmoothedResult",
    "SolverConfig",
    "SphfilterError",
    "Trajectory",
    "Uniform",
    "UpdateInfo",
    "__version__",
    "compare_models",
    "consistency",
    "fit_parameters",
    "health",
    "initialize",
    "predict",
    "profile_evidence",
    "propagate",
    "report",
    "resample",
    "run_campaign",
    "simulate",
    "smooth",
    "update",
]
