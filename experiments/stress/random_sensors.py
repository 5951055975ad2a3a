"""Random sensors, with errors from small to large against what they read."""

import numpy as np

from .sensors import GaussianReader, LikelihoodReader


def random_reader(rng, paths):
    """Draw a sensor of one of the fourteen `KINDS`.

    Parameters
    ----------
    rng : Generator
    paths : ndarray, shape (R, T, n)
        Simulated states, that tell how large the readings are.
    """
    X = paths.reshape(-1, paths.shape[-1])
    kind = str(rng.choice(list(KINDS)))
    return KINDS[kind](rng, X, kind)


def _size(values):
    """A robust standard deviation; one where nothing varies."""
    low, high = np.quantile(values, [0.16, 0.84])
    return float(0.5 * (high - low)) or 1.0


def _error(rng, values, low=0.03, high=3.0):
    """Standard deviation of a sensor's error, of three digits."""
    return float(f"{_size(values) * np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _direction(rng, n):
    """A state alone, or a sum of all."""
    if n == 1 or rng.random() < 0.7:
        return np.eye(n)[rng.integers(n)]
    return rng.standard_normal(n).round(2)


def _names(X):
    return tuple(f"x{i}" for i in range(X.shape[1]))


def _linear(rng, X, kind):
    """All states, or fewer sums of them, with independent or correlated errors."""
    n = X.shape[1]
    H = np.eye(n) if rng.random() < 0.4 else np.array([_direction(rng, n)])
    if len(H) == 1 and n > 2 and rng.random() < 0.5:
        H = np.eye(n)[np.sort(rng.permutation(n)[:2])]
    sd = np.array([_error(rng, X @ row) for row in H])
    rho = rng.uniform(-0.4, 0.9) / max(1, len(H) - 1) if rng.random() < 0.3 else 0.0
    R = (rho + (1.0 - rho) * np.eye(len(H))) * np.outer(sd, sd)
    return GaussianReader(kind=kind, states=_names(X), R=R, H=H)


def _of(form):
    """A sensor z = form(u) of one state."""

    def drawn(rng, X, kind):
        i = int(rng.integers(X.shape[1]))
        u, rate = X[:, i], f"{np.exp(rng.uniform(-0.7, 2.3)) / _size(X[:, i]):.3g}"
        with np.errstate(over="ignore"):
            values = _VALUES[kind](u, float(rate))
        R = np.array([[_error(rng, values) ** 2]])
        return GaussianReader(
            kind=kind, states=_names(X), R=R, h=(form.replace("k", rate).replace("u", f"x{i}"),)
        )

    return drawn


_VALUES = {
    "square": lambda u, k: u**2,
    "cube": lambda u, k: u**3,
    "exponential": lambda u, k: np.exp(0.7 * u),
    "saturating": lambda u, k: np.tanh(u),
    "absolute": lambda u, k: np.abs(u),
    "periodic": lambda u, k: np.sin(k * u),
}


def _place(rng, X):
    """A place among the first two states or beside them, or beside the line of the first."""
    n = min(2, X.shape[1])
    place = X[:, :n].mean(axis=0) + _size(X[:, 0]) * rng.normal(0.0, 2.0, n)
    return f"(x0 - {place[0]:.4g})", f"(x1 - {place[1]:.4g})" if n > 1 else "1.0"


def _bearing(rng, X, kind):
    along, across = _place(rng, X)
    R = np.array([[float(np.exp(rng.uniform(np.log(0.01), np.log(0.6)))) ** 2]])
    return GaussianReader(kind=kind, states=_names(X), R=R, h=(f"atan2({across}, {along})",), angles=(0,))


def _range(rng, X, kind):
    along, across = _place(rng, X)
    spread = X[:, 0] if X.shape[1] == 1 else X[:, :2].ravel() - np.tile(X[:, :2].mean(axis=0), len(X))
    R = np.array([[_error(rng, spread) ** 2]])
    return GaussianReader(kind=kind, states=_names(X), R=R, h=(f"sqrt({along}**2 + {across}**2)",))


def _likelihood(about):
    """A likelihood of one state or a sum of states."""

    def drawn(rng, X, kind):
        a = _direction(rng, X.shape[1])
        return LikelihoodReader(kind=kind, a=a, about=about(rng, X @ a))

    return drawn


def _steps(rng, u):
    """Width of the steps, and the error before rounding: none for some."""
    width = _error(rng, u, 0.1, 3.0)
    return width, 0.0 if rng.random() < 0.3 else width * float(rng.choice([0.1, 0.3]))


def _counts(rng, u):
    """Logarithm of the rate: its level at zero, and its slope."""
    slope = float(f"{rng.uniform(0.3, 1.5) / max(_size(u), 0.2):.3g}")
    return float(np.round(np.log(rng.uniform(1.0, 20.0)) - slope * np.median(u), 3)), slope


#: Makes of each kind of sensor: make(rng, X, kind).
KINDS = {
    "linear": _linear,
    "square": _of("u**2"),
    "cube": _of("u**3"),
    "exponential": _of("exp(0.7*u)"),
    "saturating": _of("tanh(u)"),
    "absolute": _of("abs(u)"),
    "periodic": _of("sin(k*u)"),
    "bearing": _bearing,
    "range": _range,
    "Laplace": _likelihood(lambda rng, u: (_error(rng, u),)),
    "robust": _likelihood(lambda rng, u: (_error(rng, u, 0.01, 1.0),)),
    "quantised": _likelihood(_steps),
    "Poisson": _likelihood(_counts),
    "Student": _likelihood(lambda rng, u: (_error(rng, u), float(rng.choice([2.0, 3.0, 5.0])))),
}
