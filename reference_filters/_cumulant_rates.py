"""Rates of change of the cumulants of a density under a polynomial drift and diffusion, cut off at an order.

With μ the mean, y = x − μ, c_α = E y^α and f(μ + y) = Σ_γ F_γ(μ) y^γ (the same for D), 000 (150) reads

    dμ_i/dt = E f_i,
    dc_α/dt = Σ_i α_i E[(f_i − E f_i) y^(α−e_i)] + Σ_ij α_i (α_j − δ_ij) E[D_ij y^(α−e_i−e_j)],

with moments up to the degree of f above those asked for. They follow from cumulants κ, those above the order
set to zero (cumulant neglect, 000 section 4.1.3), by the recursion

    c_α = Σ_{β ≤ α−e_i} C(α−e_i, β) κ_{β+e_i} c_{α−e_i−β}        for any i with α_i > 0,

which, differentiated, gives the rates of the cumulants from those of the moments. About the mean neither
loses digits where the mean is large.
"""

from itertools import product
from math import comb, prod

import numpy as np

from sphfilter.core._jit import jit
from sphfilter.core.monomials import up_to


class CumulantRates:
    """Right-hand side for the cumulants of order 1 to Q.

    Parameters
    ----------
    drift, diffusion : lists of n, and of n² (row-major), lists of powers
        The terms of f and D.
    order : int
        Q, at least 2.

    Attributes
    ----------
    powers : list of K tuples
        Of the cumulants, lowest order first.
    """

    def __init__(self, drift, diffusion, order):
        n, slots = len(drift), [*drift, *diffusion]
        degrees = [max(map(sum, terms), default=0) for terms in slots]
        excess = max(max(degrees[:n]) - 1, max(degrees[n:]) - 2, 0)
        self.powers = up_to(order, n)
        moments = up_to(order + excess, n)
        index = {a: j for j, a in enumerate(moments)}
        terms, shift, exponents = _shifted(slots, n, max(degrees))
        self._tables = (
            _table(shift), exponents, _table(_moment_terms(self.powers, terms, index, n)),
            _table(central_recursion(moments, order)),
        )  # fmt: skip
        self._sizes = n, len(terms), len(moments)

    def __call__(self, kappa, coefficients):
        """Rates (K,) of the cumulants `kappa` (K,) for the coefficients of all terms of f and D, in order.

        The zeroth cumulant is nought, those of order one are the mean.
        """
        out = np.zeros(len(self.powers))
        fill_rates(kappa, coefficients, self._sizes, *self._tables, out)
        return out


def central_recursion(powers, order):
    """Rows (α, b, a, weight) of c_α = κ_α + Σ weight κ_b c_a for the powers of order 2 and more, in order.

    Cumulants of order above `order` are zero, and so are those and moments of order one, about the mean.
    """
    index, rows = {a: j for j, a in enumerate(powers)}, []
    for alpha in powers:
        if sum(alpha) < 2:
            continue
        i = next(d for d, k in enumerate(alpha) if k)
        lower = tuple(k - (d == i) for d, k in enumerate(alpha))
        for beta in product(*(range(k + 1) for k in lower)):
            b = tuple(k + (d == i) for d, k in enumerate(beta))
            a = tuple(k - m for k, m in zip(lower, beta, strict=True))
            if 1 < sum(b) <= order and sum(a) > 1:
                rows.append((index[alpha], index[b], index[a], prod(map(comb, lower, beta))))
    return rows


def _shifted(slots, n, degree):
    """Terms (slot, γ) of polynomials about the mean, and how they follow from those about zero.

    Returns
    -------
    terms : dict of (slot, γ) to its number; those of γ = 0 of the n drifts come first
    rows : (term, coefficient, power of the mean, weight)
    exponents : ndarray, shape (P, n)
        The powers of the mean.
    """
    means = up_to(degree, n)
    terms, rows, source = {(i, (0,) * n): i for i in range(n)}, [], 0
    for slot, powers in enumerate(slots):
        for beta in powers:
            for gamma in product(*(range(k + 1) for k in beta)):
                k = terms.setdefault((slot, gamma), len(terms))
                rest = tuple(b - g for b, g in zip(beta, gamma, strict=True))
                rows.append((k, source, means.index(rest), prod(map(comb, beta, gamma))))
            source += 1
    return terms, rows, np.array(means, dtype=np.int64)


def _moment_terms(powers, terms, index, n):
    """Rows (α, term, moment, weight) of the rates of the central moments, and of the means, lowest first."""
    rows = []
    for j, alpha in enumerate(powers):
        for (slot, gamma), k in terms.items():
            down = [slot] if slot < n else [*divmod(slot - n, n)]
            weight, left = 1, list(alpha)
            for d in down:
                weight, left[d] = weight * left[d], left[d] - 1
            if weight > 0:
                rows.append((j, k, index[tuple(a + g for a, g in zip(left, gamma, strict=True))], weight))
    return rows


def _table(rows):
    """Numbers (R, 3) and weights (R,) of rows."""
    numbers = np.array([row[:3] for row in rows], dtype=np.int64).reshape(-1, 3)
    return numbers, np.array([row[3] for row in rows], dtype=float)


@jit
def fill_rates(kappa, coefficients, sizes, shift, exponents, linear, closure, out):
    """Fill the rates (K,) of cumulants; tables as made by `CumulantRates`."""
    n, n_terms, n_moments = sizes
    K = kappa.size
    mean_powers = np.ones(len(exponents))
    for e in range(len(exponents)):
        for d in range(n):
            mean_powers[e] *= kappa[1 + d] ** exponents[e, d]
    terms = np.zeros(n_terms)
    numbers, weight = shift
    for r in range(weight.size):
        terms[numbers[r, 0]] += weight[r] * coefficients[numbers[r, 1]] * mean_powers[numbers[r, 2]]
    c, rate = np.zeros(n_moments), np.zeros(K)
    c[0], c[n + 1 : K] = 1.0, kappa[n + 1 :]
    numbers, weight = closure
    for r in range(weight.size):
        c[numbers[r, 0]] += weight[r] * kappa[numbers[r, 1]] * c[numbers[r, 2]]
    numbers, weight = linear
    centred = False
    for r in range(weight.size):
        if numbers[r, 0] > n and not centred:  # the means are done: from here on f is f − E f
            terms[:n] -= rate[1 : n + 1]
            centred = True
        rate[numbers[r, 0]] += weight[r] * terms[numbers[r, 1]] * c[numbers[r, 2]]
    out[:] = rate
    rate[: n + 1] = 0.0
    numbers, weight = closure
    for r in range(weight.size):
        j, b, a = numbers[r]
        if j < K:
            out[j] -= weight[r] * (out[b] * c[a] + kappa[b] * rate[a])
