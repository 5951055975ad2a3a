"""Exceptions of the package. Each sentence says what was given, what is allowed, and what to do."""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class SphfilterError(Exception):
    """Base of every error this package raises on purpose.

    Examples
    --------
    >>> import sphfilter as sf
    >>> try:
    ...     sf.LikelihoodMeasurement(3)
    ... except sf.SphfilterError as problem:
    ...     print(problem)
    loglik must be a function (z, X, t) -> (N,), got 3.
    """


class ConfigError(SphfilterError, ValueError):
    """A configuration that cannot be used: unknown key, wrong type or value out of range.

    Examples
    --------
    >>> import sphfilter as sf
    >>> sf.FilterConfig(target_eror=0.01)
    Traceback (most recent call last):
        ...
    sphfilter.errors.ConfigError: unknown key FilterConfig.target_eror (did you mean ...
    """


class ExpressionError(SphfilterError, ValueError):
    """A text expression with an unknown name or a syntax that is not allowed.

    Examples
    --------
    >>> import sphfilter as sf
    >>> sf.SDE.from_expressions(["x"], ["-k*x"], [["1"]])
    Traceback (most recent call last):
        ...
    sphfilter.errors.ExpressionError: drift[0] '-k*x': unknown name 'k'. The names here are x, t, ...
    """


class ModelError(SphfilterError, ValueError):
    """A model, measurement or state that does not fit: wrong length, shape, NaN, not positive definite.

    Examples
    --------
    >>> import sphfilter as sf
    >>> sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[-0.1]])
    Traceback (most recent call last):
        ...
    sphfilter.errors.ModelError: noise_cov is not positive definite: its smallest eigenvalue, ...
    """


class MissingNameError(ModelError, AttributeError):
    """A name of another toolkit's filters, which a filter here has not; says what to use instead."""


class EstimationError(SphfilterError, RuntimeError):
    """Parameters that the measurements do not determine, or whose evidence cannot be computed.

    Examples
    --------
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-x + 0*a"], [["1"]], parameters={"a": 1.0})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> sf.fit_parameters(flt, [1.0, 2.0], [0.3, -0.2], {"a": 1.0})
    Traceback (most recent call last):
    ...
    sphfilter.errors.EstimationError: the measurements do not determine 'a': from ...
    """


class PropagationError(SphfilterError, RuntimeError):
    """A prediction or update that could not be completed; the filter is as it was before the call.

    Examples
    --------
    >>> import sphfilter as sf
    >>> start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=60)
    >>> sf.predict(start, sf.SDE.from_expressions(["x"], ["x**3"], [["1"]]), 1.0)
    Traceback (most recent call last):
        ...
    sphfilter.errors.PropagationError: the model blew up at t = ... Check the drift ...

    Attributes
    ----------
    work : float
        Evaluations of the drift that the whole prediction would have taken; zero where none were counted.
    """

    work: float = 0.0


class CampaignError(SphfilterError, RuntimeError):
    """A campaign that cannot go on; the runs that are finished are kept in its folder."""


class LatticeError(PropagationError):
    """No lattice of so many particles holds this density."""


class StoppedError(PropagationError):
    """Steps of a prediction that became too small, or too many."""


class UnresolvedError(PropagationError):
    """No scheme can be trusted with this density on so few particles."""


def plain(name: Any) -> Any:
    """Return a name as Python itself reads it in a text: the micro sign is a mu there, and so on (NFKC)."""
    return unicodedata.normalize("NFKC", name) if isinstance(name, str) else name


def nearest(name: object, allowed: Iterable[object]) -> str:
    """Return " (did you mean 'x'?)" for the allowed name nearest to `name`, or an empty string."""
    known = {str(a).lower(): str(a) for a in allowed}
    match = get_close_matches(str(name).lower(), known, n=1, cutoff=0.5)
    return f" (did you mean {known[match[0]]!r}?)" if match else ""
