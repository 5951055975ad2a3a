"""Distances of a density from the exact one: of its moments, and of its values."""

from dataclasses import dataclass, fields

import numpy as np

from experiments.show.comparison import moment_errors


@dataclass(frozen=True)
class Errors:
    """Root mean squares over the output times of the distance of a density p from the exact p*."""

    mean: float  # |L⁻¹ (m - m*)| with L Lᵀ = C*: standard deviations
    cov: float  # ‖L⁻¹ (C - C*) L⁻ᵀ‖ (Frobenius) over √n
    # ‖p - p*‖ / ‖p*‖, as 001 (34) but over the states and not over the particles; NaN if p* is not known
    l2: float
    hellinger: float  # (½ ∫ (√p - √p*)²)^½, between zero and one; NaN if p* is not known


#: Names of the measures, and what they are for people.
MEASURES = dict(
    zip(
        (field.name for field in fields(Errors)),
        ("mean (std)", "covariance", "density, L2", "Hellinger"),
        strict=True,
    )
)


@dataclass(frozen=True)
class Truth:
    """What densities at T times are compared with."""

    name: str  # what it is, for people
    # shapes (T, n), (T, n, n)
    mean: np.ndarray
    cov: np.ndarray
    # shapes (M, n), (M,), (M,), or empty: a quadrature of integrals over the states, and the density at its
    # nodes; empty if not known
    nodes: tuple = ()
    values: tuple = ()
    weights: tuple = ()
    doubt: Errors | None = None  # bound of its own errors, where it is not exact

    def seen_by(self, densities):
        """The `Truth` that other densities at the same times would be, at the same nodes."""
        return Truth(
            name="another solution",
            mean=np.array([moments_of(density)[0] for density in densities]),
            cov=np.array([moments_of(density)[1] for density in densities]),
            nodes=self.nodes,
            values=tuple(density.pdf(X) for density, X in zip(densities, self.nodes, strict=False)),
            weights=self.weights,
        )


def errors_of(densities, truth):
    """`Errors` of T densities, which know `mean`, `cov` and `pdf`."""
    of_moments = [
        moment_errors(*moments_of(density), mean, cov)
        for density, mean, cov in zip(densities, truth.mean, truth.cov, strict=True)
    ]
    known = zip(densities, truth.nodes, truth.values, truth.weights, strict=False)
    of_values = [_of_values(density.pdf(X), p, w) for density, X, p, w in known]
    rows = np.hstack([of_moments, of_values or np.full((len(of_moments), 2), np.nan)])
    return Errors(*(float(value) for value in np.sqrt(np.mean(rows**2, axis=0))))


def moments_of(density):
    """Mean (n,) and covariance (n, n) of a density.

    A log-density's are sums that go on beyond its cut edge, as those of `ParticleDensity.moment` do: `cov`
    stops a ring of cells beyond the edge, which costs up to Z²/2 exp(-Z²/2) of it, more on finer lattices.
    """
    if getattr(density, "field", None) is None:
        return density.mean(), density.cov()
    X = density.cells
    w = density.pdf(X)
    w /= w.sum()
    mean = w @ X
    return mean, ((X - mean) * w[:, None]).T @ (X - mean)


def _of_values(p, p_ref, w):
    l2 = np.sqrt(w @ (p - p_ref) ** 2 / (w @ p_ref**2))
    return l2, np.sqrt(0.5 * (w @ (np.sqrt(p) - np.sqrt(p_ref)) ** 2))
