"""Accuracy studies: filters against exact ones, transient densities against closed forms and grids."""

from .filters import convergence, orders

__all__ = ["convergence", "orders"]
