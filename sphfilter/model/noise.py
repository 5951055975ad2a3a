"""The noise of a model from its arguments: g and Q, or D itself; a matrix or a function."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats
from ..errors import ModelError
from . import derived
from .compile import (
    Data,
    Maker,
    StateFunction,
    arguments_of,
    compile_rows,
    probe_states,
    reads_argument,
    shared,
)

Noise: TypeAlias = ArrayLike | StateFunction
#: Makers of g, D and ∇·D, then Q, the constants that end p, and the flags of the noise.
NoiseParts: TypeAlias = tuple[dict[str, Maker], Floats, Floats, dict[str, Any]]


def reads_time(function: Callable[..., Any], name: str, data: Data) -> bool:
    """Tell whether a model function may depend on time; False is a proof."""
    return len(arguments_of(function, name, data)) > 1 and reads_argument(function, 1)


def noise_parts(
    noise: Noise | None,
    spectral_density: ArrayLike | None,
    diffusion: Noise | None,
    n: int,
    data: Data,
    vectorized: bool,
) -> NoiseParts:
    """Return makers of g, D and ∇·D, then Q, the constants that end p, and the flags of the noise."""
    check_noise(noise, spectral_density, diffusion)
    if diffusion is not None:
        if callable(diffusion):
            return _diffusion_function(diffusion, n, data, vectorized)
        noise = constant_root(validate.covariance("diffusion", diffusion, n, definite=False))
    if callable(noise):
        return _noise_function(noise, spectral_density, n, data, vectorized)
    what = f"a row for each of dim = {n} states, a column for each noise"
    g = np.zeros((n, 1)) if noise is None else validate.array("noise", noise, (n, None), what)
    Q = density_of_noises(spectral_density, g.shape[1])
    makers = {
        "noise": lambda fs: shared(derived.constant_noise),
        "diffusion": lambda fs: shared(derived.constant_diffusion),
        "diffusion_divergence": lambda fs: shared(derived.zeros),
    }
    tail = np.concatenate([g.ravel(), (0.5 * g @ Q @ g.T).ravel()])
    return makers, Q, tail, structure(False, False)


def _noise_function(
    noise: Callable[..., Any], spectral_density: ArrayLike | None, n: int, data: Data, vectorized: bool
) -> NoiseParts:
    if spectral_density is None:
        raise ModelError("noise= is a function: give spectral_density= of shape (m, m) too, it tells m.")
    Q = validate.covariance("spectral_density", spectral_density, definite=False)
    g = compile_rows(noise, (n, len(Q)), "noise", n, data, vectorized)
    makers = {"noise": lambda fs: g, "diffusion": lambda fs: derived.diffusion_from_noise(g, Q)}
    return _with_divergence(makers, noise, "noise", Q, data)


def _diffusion_function(diffusion: Callable[..., Any], n: int, data: Data, vectorized: bool) -> NoiseParts:
    D = compile_rows(diffusion, (n, n), "diffusion", n, data, vectorized)
    out = np.empty((3, n * n))
    D(probe_states(n), 0.0, np.concatenate(data), out)
    for matrix in out.reshape(-1, n, n):
        if np.isfinite(matrix).all():
            validate.covariance("diffusion", matrix, n, definite=False)
    makers = {"noise": lambda fs: derived.noise_from_diffusion(D), "diffusion": lambda fs: D}
    return _with_divergence(makers, diffusion, "diffusion", np.eye(n), data)


def _with_divergence(
    makers: dict[str, Maker], function: Callable[..., Any], name: str, Q: Floats, data: Data
) -> NoiseParts:
    depends = reads_argument(function, 0)
    if depends:
        makers["diffusion_divergence"] = lambda fs: derived.row_divergence_from(fs["diffusion"])
    else:
        makers["diffusion_divergence"] = lambda fs: shared(derived.zeros)
    return makers, Q, np.empty(0), structure(depends, reads_time(function, name, data))


def structure(state_dependent: bool, time_dependent: bool) -> dict[str, Any]:
    """Return the structure flags that the noise alone decides."""
    return {
        "state_dependent_noise": state_dependent,
        "constant_diffusion": not (state_dependent or time_dependent),
        "autonomous": not time_dependent,
        "linear": False,
    }


def check_noise(noise: Any, spectral_density: Any, diffusion: Any) -> None:
    """Raise `ModelError` where the noise is given in two ways, or half of one."""
    if diffusion is not None and (noise is not None or spectral_density is not None):
        raise ModelError("Give either noise= with spectral_density=, or diffusion=, not both.")
    if diffusion is None and noise is None and spectral_density is not None:
        raise ModelError("spectral_density= is given without noise=; give noise= of shape (n, m) too.")


def density_of_noises(Q: ArrayLike | None, m: int) -> Floats:
    """Spectral density of m noises, checked; the identity if none is given."""
    return np.eye(m) if Q is None else validate.covariance("spectral_density", Q, m, definite=False)


def constant_root(D: Floats) -> Floats:
    """Return g with g gᵀ = 2 D and as many columns as D has rank; rows of D that are zero stay exactly so."""
    d = derived.scales(D)
    w, V = np.linalg.eigh(D / np.outer(d, d))
    keep = w > 1e-14 * max(w.max(), 0.0)
    g = d[:, None] * V[:, keep] * np.sqrt(2.0 * w[keep]) if keep.any() else np.zeros((len(D), 1))
    g[~D.any(axis=1)] = 0.0
    return g
