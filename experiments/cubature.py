"""Solve for fully symmetric cubature rules: nodes and positive weights for the standard normal law.

`sphfilter/core/family/rules.json` has what `solved` found, by number of states and degree.
"""

import itertools
import math

import numpy as np
from scipy.optimize import least_squares

_EXACT = 1e-13  # largest error of a scaled moment
_PROMISING = 1e-6  # of least squares, for Newton's steps to go on from


def solved(n, degree, orbits, tries, seed, within):
    """Weights (K,) of each point and generators (K, n) of a positive rule; None if none is found.

    The rule is to be exact to degree 2 `degree` + 1. Its K orbits are patterns of generators, a letter for
    each equal number and 0 for zero, such as 000, a00 and aab. Least squares start at random, `tries` times.
    No node is further out than `within`: families are the steadier, the nearer their nodes are.
    """
    problem, rng = _Moments(n, degree, orbits, within), np.random.default_rng(seed)
    for _ in range(tries):
        first = problem.random(rng)
        fit = least_squares(problem.errors, first, problem.jacobian, max_nfev=400, xtol=1e-15, ftol=1e-15)
        if np.abs(fit.fun).max() < _PROMISING:
            unknown = _polished(problem, fit.x)
            if np.abs(problem.errors(unknown)).max() < _EXACT:
                return problem.rule(unknown)
    return None


def _polished(problem, unknown):
    """Newton's steps, the shortest where there are more unknowns than equations."""
    for _ in range(20):
        step = np.linalg.lstsq(problem.jacobian(unknown), problem.errors(unknown), rcond=1e-12)[0]
        unknown = unknown - step
    return unknown


class _Moments:
    """The moment equations of orbits. Unknown are the logarithms of the weights, and of what each number of a
    generator has of the square of the largest radius, over what is left of that.
    """

    def __init__(self, n, degree, orbits, within):
        self.square = within**2
        self.orbits, self.size = orbits, np.array([_size(orbit) for orbit in orbits])
        self.letters = [sorted(set(orbit) - {"0"}) for orbit in orbits]
        powers = [a for a in itertools.product(range(degree + 1), repeat=n) if sum(a) <= degree]
        self.powers = np.array([a for a in powers if list(a) == sorted(a, reverse=True)])
        doubled = [np.prod([_odd_factorial(2 * k - 1) for k in a]) for a in self.powers]
        self.scale = np.sqrt([np.prod([_odd_factorial(4 * k - 1) for k in a]) for a in self.powers])
        self.exact = np.array(doubled, dtype=float)
        self.permuted = np.array(list(itertools.permutations(range(n))))

    def random(self, rng):
        """Unknowns to start from."""
        share = rng.dirichlet(np.ones(len(self.orbits)))
        return np.concatenate([np.log(share / self.size), rng.normal(0.0, 2.0, sum(map(len, self.letters)))])

    def squares(self, unknown):
        """Squares of the generators (K, n)."""
        parts, out = iter(np.exp(unknown[len(self.orbits) :])), []
        for orbit, letters in zip(self.orbits, self.letters, strict=True):
            part = {letter: next(parts) for letter in letters}
            unit = self.square / (1.0 + sum(part.values()))
            value = {"0": 0.0} | {letter: unit * part[letter] / orbit.count(letter) for letter in letters}
            out.append([value[letter] for letter in orbit])
        return np.array(out)

    def errors(self, unknown):
        """Errors (E,) of the moments, in units of the root of the monomial's own second moment."""
        squares, weight = self.squares(unknown), self.size * np.exp(unknown[: len(self.orbits)])
        turned = squares[:, self.permuted]  # (K, P, n)
        moment = np.prod(turned[:, :, None, :] ** self.powers, axis=3).mean(axis=1)
        return (weight @ moment - self.exact) / self.scale

    def jacobian(self, unknown):
        """Derivatives (E, U), by complex steps: exact to rounding."""
        steps = unknown + 1e-30j * np.eye(len(unknown))
        return np.column_stack([self.errors(moved).imag / 1e-30 for moved in steps])

    def rule(self, unknown):
        """Weights (K,) and generators (K, n)."""
        return np.exp(unknown[: len(self.orbits)]), np.sqrt(self.squares(unknown))


def _size(orbit):
    """Points of an orbit: permutations of its generator with all signs."""
    alike = np.prod([math.factorial(orbit.count(letter)) for letter in set(orbit)])
    return 2 ** sum(letter != "0" for letter in orbit) * math.factorial(len(orbit)) // int(alike)


def _odd_factorial(k):
    return math.prod(range(k, 0, -2))
