"""Exceptions of the package. Each sentence says what was given, what is allowed, and what to do."""

from difflib import get_close_matches

__all__ = [
    "ConfigError",
    "EstimationError",
    "ExpressionError",
    "ModelError",
    "PropagationError",
    "SphfilterError",
    "UnresolvedError",
    "nearest",
]


class SphfilterError(Exception):
    """Base of every error this package raises on purpose."""


class ConfigError(SphfilterError, ValueError):
    """A configuration that cannot be used: unknown key, wrong type or value out of range."""


class ExpressionError(SphfilterError, ValueError):
    """A text expression with an unknown name or a syntax that is not allowed."""


class ModelError(SphfilterError, ValueError):
    """A model, measurement or state that does not fit: wrong length, shape, NaN, not positive definite."""


class EstimationError(SphfilterError, RuntimeError):
    """Parameters that the measurements do not determine, or whose evidence cannot be computed."""


class PropagationError(SphfilterError, RuntimeError):
    """A prediction or update that could not be completed; the filter is as it was before the call."""


class LatticeError(PropagationError):
    """No lattice of so many particles holds this density."""


class UnresolvedError(PropagationError):
    """No scheme can be trusted with this density on so few particles."""


def nearest(name, allowed):
    """Return " (did you mean 'x'?)" for the allowed name nearest to `name`, or an empty string."""
    match = get_close_matches(str(name), [str(a) for a in allowed], n=1, cutoff=0.5)
    return f" (did you mean {match[0]!r}?)" if match else ""
