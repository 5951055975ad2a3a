"""Cubature rules for the standard normal law, exact to twice the degree of a family and one more."""

import itertools
import json
from functools import cache
from pathlib import Path

import numpy as np

#: Gauss-Hermite points of one state, over the degree: fewer do not see what a polynomial misses. Cubics rise
#: on one side, and see little else at points further out.
_MORE, _MORE_OF_CUBICS = 9, 2
#: Degrees whose own rule is blind in two and three states: a polynomial that is a half to nine tenths off
#: seems right at its nodes. Those of the next rule see it.
_BLIND = {(2, 4), (3, 4)}
_HIGHEST = 8  # degree of one state
MOST = 12  # states that have a rule: 2^12 = 4,096 corners; measured by tests/filter/test_many_states.py


@cache
def _found():
    """Generators and weights of fully symmetric rules of two and more states, by states and degree."""
    table = json.loads(Path(__file__).with_name("rules.json").read_text())
    return {tuple(map(int, name.split())): found for name, found in table.items()}


@cache
def degrees(n):
    """Degrees of the families of n states that have a rule, lowest first."""
    if n == 1:
        return tuple(range(2, _HIGHEST + 1))
    found = sorted(degree for states, degree in _found() if states == n)
    return (2, *found) if n <= MOST else ()


@cache
def rule(n, degree):
    """Nodes (N, n) and weights (N,) that integrate polynomials of degree 2 `degree` + 1; read-only."""
    if n == 1:
        points, weights = np.polynomial.hermite_e.hermegauss(
            degree + (_MORE if degree > 3 else _MORE_OF_CUBICS)
        )
        points, weights = points[:, None], weights / weights.sum()
    elif degree == 2 and degrees(n) == (2,):
        points, weights = _of_corners(n)
    else:
        wanted = degree + ((n, degree) in _BLIND)
        least = min(known for states, known in _found() if states == n and known >= wanted)
        found = _found()[n, least]
        orbits = [_orbit(generator) for generator in found["generators"]]
        points = np.ascontiguousarray(np.concatenate(orbits))
        weights = np.repeat(found["weights"], [len(orbit) for orbit in orbits])
    points.flags.writeable = weights.flags.writeable = False
    return points, weights


def _of_corners(n):
    """Nodes and positive weights exact to degree five, of many states: Stroud's rule 5-3 (1971)."""
    r, s = np.sqrt((n + 2) / 2), np.sqrt((n + 2) / (n - 2))
    corners = s * np.array(list(itertools.product((-1.0, 1.0), repeat=n)))
    points = np.concatenate([r * np.eye(n), -r * np.eye(n), corners])
    shares = 4.0 / (n + 2) ** 2, (n - 2) ** 2 / (2.0**n * (n + 2) ** 2)
    return points, np.repeat(shares, [2 * n, 2**n])


def _orbit(generator):
    """All permutations of a generator with all signs, shape (K, n)."""
    signs = itertools.product(*[(r,) if r == 0.0 else (r, -r) for r in generator])
    return np.array(sorted({turned for signed in signs for turned in itertools.permutations(signed)}))
