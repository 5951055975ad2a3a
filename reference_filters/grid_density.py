"""A density on a regular grid whose box may lie askew: moments, blurring, interpolation, support."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy import fft

from sphfilter import validate

from ._spline import evaluate_spline, spline_symbol

#: Relative density below which a node counts as empty.
FLOOR = 1e-11
#: Half-width of a Gaussian at that floor, in standard deviations.
REACH = np.sqrt(-2 * np.log(FLOOR))


@dataclass(frozen=True)
class Box:
    """Nodes x = centre + axes @ y with y in [-1, 1)ⁿ, `size` of them an axis.

    Attributes
    ----------
    centre : ndarray, shape (n,)
    axes : ndarray, shape (n, n)
        Half-edges, as columns.
    size : int
    """

    centre: np.ndarray
    axes: np.ndarray
    size: int

    @classmethod
    def between(cls, limits, size):
        """Box with edges along the axes of the state; limits (n, 2)."""
        limits = validate.array("box", limits, (None, 2))
        return cls(limits.mean(axis=1), np.diag(0.5 * np.diff(limits, axis=1)[:, 0]), size)

    @property
    def dim(self):
        """Number of dimensions."""
        return self.centre.size

    @property
    def shape(self):
        """Shape of the values on the nodes."""
        return self.dim * (self.size,)

    @property
    def cell(self):
        """Volume of a cell."""
        return abs(np.linalg.det(self.axes)) * (2.0 / self.size) ** self.dim

    def nodes(self):
        """States at the nodes, shape (size**n, n), the last axis fastest; not to be written to."""
        return self._nodes

    @cached_property
    def _nodes(self):
        y = -1.0 + 2.0 / self.size * np.arange(self.size)
        mesh = np.stack(np.meshgrid(*self.dim * [y], indexing="ij"), axis=-1)
        return self.centre + mesh.reshape(-1, self.dim) @ self.axes.T

    @cached_property
    def to_indices(self):
        """Matrix (n, n) and origin (n,) that turn a state into fractional node indices."""
        matrix = np.linalg.inv(self.axes) * (0.5 * self.size)
        return matrix, 0.5 * self.size - matrix @ self.centre

    def indices(self, X):
        """Fractional node indices of states X (N, n), shape (N, n)."""
        matrix, origin = self.to_indices
        return X @ matrix.T + origin

    def wave_numbers(self):
        """Wave numbers of a real transform in radians a node, one broadcastable array an axis."""
        return _wave_numbers(self.size, self.dim)


@cache
def _wave_numbers(size, dim):
    full, half = 2 * np.pi * fft.fftfreq(size), 2 * np.pi * fft.rfftfreq(size)
    axes = [full] * (dim - 1) + [half]
    return [k.reshape([-1 if a == i else 1 for a in range(dim)]) for i, k in enumerate(axes)]


@cache
def _symbol(size, dim):
    return np.prod(np.broadcast_arrays(*map(spline_symbol, _wave_numbers(size, dim))), axis=0)


@dataclass(frozen=True)
class GridDensity:
    """Values of a density on the nodes of a box; slightly negative in the tails, as splines are.

    Attributes
    ----------
    box : Box
    values : ndarray, shape (size,) * n
    """

    box: Box
    values: np.ndarray

    @classmethod
    def sampled(cls, pdf, box):
        """Density of a function pdf(X (N, n)) -> (N,), normalised on the box."""
        values = np.asarray(pdf(box.nodes()), dtype=float).reshape(box.shape)
        return cls(box, values / (values.sum() * box.cell))

    @property
    def mass(self):
        """Integral over the box. The sum is spectrally accurate where the density ends inside."""
        return self.values.sum() * self.box.cell

    def normalised(self):
        """The density with unit mass."""
        return GridDensity(self.box, self.values / self.mass)

    def moments(self):
        """Mean (n,) and covariance (n, n)."""
        return _weighted_moments(self.box.nodes(), self.values.ravel() / self.values.sum())

    def pdf(self, X):
        """Density at X (N, n), zero outside the box, shape (N,)."""
        X = validate.state_rows("X", X, self.box.dim)
        return np.maximum(self.interpolated(X, self.coefficients()), 0.0) / self.mass

    def on(self, box):
        """The same density on another box."""
        return GridDensity(box, self.interpolated(box.nodes(), self.coefficients()).reshape(box.shape))

    def interpolated(self, X, coefficients):
        """Spline with `coefficients` on this box at X (N, n), shape (N,)."""
        return evaluate_spline(coefficients, X, *self.box.to_indices)

    def coefficients(self, blur=None):
        """Spline coefficients, after convolution with N(0, blur) if that is given, shape (n, n)."""
        return self._filtered(self._gaussian(blur) / _symbol(self.box.size, self.box.dim))

    def blurred(self, blur):
        """The density convolved with N(0, blur), blur (n, n)."""
        return GridDensity(self.box, self._filtered(self._gaussian(blur)))

    def _gaussian(self, blur):
        """Fourier transform of N(0, blur) on this box."""
        if blur is None:
            return 1.0
        to_index, _ = self.box.to_indices
        C = to_index @ blur @ to_index.T
        k = self.box.wave_numbers()
        return np.exp(-0.5 * sum(C[a, b] * k[a] * k[b] for a in range(len(k)) for b in range(len(k))))

    def _filtered(self, factor):
        return fft.irfftn(fft.rfftn(self.values) * factor, s=self.values.shape)

    def support(self, stride=1):
        """States (K, n) and values (K,) of the nodes that are not empty, every `stride`-th of each axis.

        The floor rises with the noise of the splines, or that noise would keep the box from shrinking.
        """
        noise = min(-3.0 * self.values.min(), 1e-3 * self.values.max())
        inside = np.zeros(self.values.shape, dtype=bool)
        every = self.values.ndim * (slice(None, None, stride),)
        inside[every] = self.values[every] > max(FLOOR * self.values.max(), noise)
        return self.box.nodes()[inside.ravel()], self.values[inside]


def _weighted_moments(X, w):
    mean = w @ X
    Y = X - mean
    return mean, (w[:, None] * Y).T @ Y


def fitted_box(X, weights, spread, size):
    """Box around weighted states, whitened by their covariance, that will be blurred by N(0, spread).

    Parameters
    ----------
    X, weights : ndarray, shapes (K, n), (K,)
    spread : ndarray, shape (n, n)
    size : int
        Nodes an axis.

    Returns
    -------
    Box
    """
    mean, cov = _weighted_moments(X, weights / weights.sum())
    L = np.linalg.cholesky(cov + spread)
    to_white = np.linalg.inv(L)
    Y = (X - mean) @ to_white.T
    low, high = Y.min(axis=0), Y.max(axis=0)
    widening = REACH**2 * np.diag(to_white @ spread @ to_white.T)
    half = np.sqrt((0.5 * (high - low)) ** 2 + widening) * (1.02 + 4.0 / size)
    return Box(mean + L @ (0.5 * (low + high)), L * half, size)
