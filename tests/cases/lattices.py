"""Fields on small lattices, for the tests of the log-density scheme's core."""

import itertools

import numpy as np

from sphfilter.core.field.field import evaluate
from sphfilter.core.field.fitting import build_field
from sphfilter.core.field.stencils import stencils


def exponents_of(sten):
    """Exponents (M, n) of the monomials, from the products that make them."""
    E = np.zeros((len(sten.parent), sten.offsets.shape[1]), int)
    for k, (parent, axis) in enumerate(zip(sten.parent, sten.axis, strict=True)):
        assert parent < k
        E[k] = E[parent] if parent >= 0 else 0
        E[k, axis] += 1
    return E


def monomials(d, E):
    """Values (M,) of the monomials at one point."""
    return np.prod(np.asarray(d, float) ** E, axis=1)


def disc(n, radius):
    """Integer vectors (N, n) within a radius: an opened set for the radii used here."""
    k = int(radius)
    g = np.array(list(itertools.product(range(-k, k + 1), repeat=n)))
    return g[(g**2).sum(axis=1) <= radius**2]


def lower(n):
    below = np.tril(np.random.default_rng(n).uniform(-0.4, 0.4, (n, n)), -1)
    return below + np.diag(np.linspace(0.5, 1.5, n))


def field_of(function, n, radius):
    """A field with `function` of the lattice coordinates (N, n) as its log p."""
    node, mu = disc(n, radius), np.linspace(-1.0, 2.0, n)
    return build_field(mu, lower(n), node, len(node), function(node.astype(float)), stencils(n))


def ask(field, d):
    """Values at lattice coordinates d (M, n)."""
    Y, out = np.ascontiguousarray(field.mu + d @ field.A.T), np.empty(len(d))
    evaluate(field, stencils(field.mu.size), Y, out)
    return out


def complete(field):
    """Numbers of the nodes that have a polynomial of their own."""
    return np.unique(field.owner[field.owner >= 0])
