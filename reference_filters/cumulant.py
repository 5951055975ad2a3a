"""Cumulant equations of 000 section 4.1.3: moments of all orders up to Q of a polynomial model.

The thesis' main rival on the Duffing oscillators (its Table 4): a system of ordinary differential equations,
closed by neglecting the cumulants above Q. Exact where the model is linear and the start Gaussian, good where
the density is nearly Gaussian; on bimodal densities it settles on a wrong variance or diverges.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import bernoulli

from sphfilter import validate
from sphfilter.core.dormand_prince import A, C, E
from sphfilter.density.distributions import Gaussian, Uniform
from sphfilter.errors import ModelError

from ._cumulant_rates import CumulantRates, central_recursion
from ._monomials import recentred
from ._polynomial import polynomials_of

#: Most steps between two times, and least step in units of the time.
_MAX_STEPS, _LEAST = 20_000, 1e-12


@dataclass(frozen=True)
class CumulantReference:
    """Cumulants of K orders at T times; NaN where the equations have diverged.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Seconds.
    powers : list of K tuples
        Of orders 0 to Q, lowest first.
    cumulants : ndarray, shape (T, K)
    diverged : str
        What happened and when; empty if nothing did.
    """

    times: np.ndarray
    powers: list
    cumulants: np.ndarray
    diverged: str

    @property
    def order(self):
        """Q, above which cumulants are neglected."""
        return sum(self.powers[-1])

    @property
    def mean(self):
        """Means, shape (T, n)."""
        return self.cumulants[:, 1 : 1 + len(self.powers[0])]

    @property
    def central_moments(self):
        """Central moments in the order of `powers`, shape (T, K)."""
        n = len(self.powers[0])
        c = self.cumulants.copy()
        c[:, 0], c[:, 1 : n + 1] = self.cumulants[:, 0] + 1.0, 0.0 * self.mean
        for j, b, a, weight in central_recursion(self.powers, self.order):
            c[:, j] += weight * self.cumulants[:, b] * c[:, a]
        return c

    @property
    def moments(self):
        """Raw moments in the order of `powers`, shape (T, K)."""
        return recentred(self.central_moments, self.powers, self.mean, self.powers)

    def moment(self, powers, central=False):
        """One moment E Π x_d^a_d at all times, shape (T,)."""
        a = tuple(int(k) for k in powers)
        if a not in self.powers:
            raise ModelError(f"moment {a} is not among those of order 0 to {self.order}; raise the order.")
        return (self.central_moments if central else self.moments)[:, self.powers.index(a)]


def cumulant_moments(model, start, times, order, *, t0=0.0, rtol=1e-7, step=None):
    """Solve the cumulant equations of a model with polynomial drift and diffusion.

    Moment equations that are closed in the same way have the same solution; cumulants are the better
    variables (000 section 4.1.3).

    Parameters
    ----------
    model : SDE
        From text, or linear; noise may depend on time, and on the state as a polynomial.
    start : Gaussian or Uniform
        Law of the state at `t0`.
    times : array_like, shape (T,)
        Non-decreasing, seconds, none before `t0`.
    order : int
        Q >= 2, such as 2, 4, 6, 8; there are (Q + n)! / (Q! n!) - 1 equations.
    t0 : float
    rtol : float
        Error allowed per step, relative to products of standard deviations or to the cumulant itself.
    step : float, optional
        Fixed step of the classical Runge-Kutta method, seconds (000 section 4.2.5 takes .05), instead of the
        adaptive method of order 5.

    Returns
    -------
    CumulantReference
        Equations that diverge are no error: `diverged` tells, and what follows is NaN.

    Raises
    ------
    ModelError
        The model is no polynomial, or the start is of another kind.
    """
    times, t, polynomials = validate.times("times", times), validate.real("t0", t0), polynomials_of(model)
    if times[0] < t:
        raise ModelError(f"times begin at {times[0]:g}, before the start at t0 = {t:g}.")
    order = validate.count("order", order, 2)
    rtol = validate.positive("rtol", rtol)
    rates = CumulantRates(polynomials.drift, polynomials.diffusion, order)

    def f(s, y):
        return rates(y, polynomials.coefficients(s))

    march = _Adaptive(f, rates.powers, rtol) if step is None else _Fixed(f, validate.positive("step", step))
    y, found, told = _start_cumulants(start, rates.powers, model.dim), [], ""
    with np.errstate(all="ignore"):  # what diverges overflows
        for t1 in times:
            if not told:
                y, told = _advanced(march, rates.powers, y, t, t1)
            t = t1
            found.append(np.full_like(y, np.nan) if told else y)
    return CumulantReference(times, rates.powers, np.array(found), told)


def _advanced(march, powers, y, t, t1):
    """Cumulants at t1, and a sentence if they diverged on the way."""
    variances = [powers.index(tuple(row)) for row in 2 * np.eye(len(powers[0]), dtype=int)]
    for _ in range(_MAX_STEPS):
        if t >= t1:
            return y, ""
        t_new, y = march.step(t, y, t1)
        if not np.isfinite(y).all():
            return y, f"the cumulants grew without bound near t = {t:.4g} s"
        if np.any(y[variances] < 0.0):
            return y, f"a variance became negative at t = {t_new:.4g} s: no density has such cumulants"
        t = t_new
    return y, f"the cumulants changed ever faster: {_MAX_STEPS} steps led to t = {t:.4g} s only"


class _Adaptive:
    """Dormand & Prince 5(4), with errors relative to products of standard deviations."""

    def __init__(self, f, powers, rtol):
        self._f, self._rtol, self._h = f, rtol, np.inf
        self._powers = np.array(powers)
        self._variances = [powers.index(tuple(row)) for row in 2 * np.eye(len(powers[0]), dtype=int)]

    def step(self, t, y, t1):
        """One step towards t1: the time it led to, and y there; NaN if no step is short enough."""
        k, h = np.empty((7, y.size)), min(self._h, t1 - t)
        k[0] = self._f(t, y)
        while h > _LEAST * max(abs(t), abs(t1)):
            new = y
            for s in range(1, 7):
                new = y + h * (A[s, :s] @ k[:s])
                k[s] = self._f(t + C[s] * h, new)
            deviation = np.sqrt(np.maximum(y, new)[self._variances])
            scale = np.prod(deviation**self._powers, axis=1) + np.abs(new)
            scale[1 : len(deviation) + 1] = deviation
            ratio = np.max(np.abs(h * (E @ k)) / scale) / self._rtol
            if ratio <= 1.0:
                longer = h * min(5.0, 0.9 * ratio**-0.2)
                self._h = longer if h < t1 - t else max(longer, self._h if self._h < np.inf else 0.0)
                return (t1 if h >= t1 - t else t + h), new
            h *= max(0.2, 0.9 * ratio**-0.2) if ratio < np.inf else 0.2  # NaN too
        return t, np.full_like(y, np.nan)


class _Fixed:
    """The classical Runge-Kutta method with equal steps between two times."""

    def __init__(self, f, step):
        self._f, self._step = f, step

    def step(self, t, y, t1):
        """One step towards t1: the time it led to, and y there."""
        left = max(1, int(np.ceil((t1 - t) / self._step * (1 - 1e-12))))
        f, h = self._f, (t1 - t) / left
        k1 = f(t, y)
        k2 = f(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = f(t + 0.5 * h, y + 0.5 * h * k2)
        k4 = f(t + h, y + h * k3)
        return (t1 if left == 1 else t + h), y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def _start_cumulants(start, powers, n):
    """Cumulants of a Gaussian, or of a uniform box: B_k (high - low)^k / k along each axis."""
    y = np.zeros(len(powers))
    if isinstance(start, Gaussian):
        mean, cov = validate.array("mean of the start", start.mean, (n,)), start.cov
        units = np.eye(n, dtype=int)
        for i in range(n):
            for j in range(i + 1):
                y[powers.index(tuple(units[i] + units[j]))] = cov[i, j]
    elif isinstance(start, Uniform):
        low, high = validate.array("box of the start", start.box, (n, 2)).T
        mean, B = 0.5 * (low + high), bernoulli(sum(powers[-1]))
        for j, a in enumerate(powers):
            if sum(a) > 1 and np.count_nonzero(a) == 1:
                y[j] = B[sum(a)] * (high - low)[np.argmax(a)] ** sum(a) / sum(a)
    else:
        raise ModelError(f"the cumulant equations start from a Gaussian or a Uniform, not from {start!r}.")
    y[1 : n + 1] = mean
    return y
