"""Bayes filters that carry the probability density itself, solved with smoothed particle hydrodynamics."""

from ._version import __version__

__all__ = ["__version__"]
