"""What the paper's march carries, is told, and counts."""

from typing import NamedTuple

import numpy as np
from numba import types

from .._jit import MATRIX, VECTOR, jit
from .._records import type_of
from ..domain import VIEW, View
from .kernels import RADIUS

INTEGRATORS = ("euler", "midpoint", "rk4")


class Cloud(NamedTuple):
    """The particles, updated in place. `invariant` is rho h^n on the last lattice, zero if not known."""

    x: np.ndarray  # (N, n)
    m: np.ndarray  # (N,)
    h: np.ndarray
    invariant: np.ndarray
    rho: np.ndarray


class Near(NamedTuple):
    """What particles see: themselves with their images, and lists of neighbours with their distances."""

    seen: View
    lists: tuple  # (start, neighbors), of `neighbor_lists`
    r: np.ndarray  # one distance for each entry of the lists


class Equations(NamedTuple):
    """dx = f(x, t) dt + g dW with diffusion matrix D = g Q g^T / 2, as far as D is constant.

    `drift`, `diffusion` and `divergence` (of D) are addresses of functions of signature `BATCH`, which
    `function_at` makes functions again.
    """

    drift: int
    diffusion: int
    divergence: int
    p: np.ndarray  # parameters of the model
    D: np.ndarray  # (n, n), used where neither time nor state changes it
    rows: np.ndarray  # numbers of the rows of D that are not zero
    time_dependent: bool
    state_dependent: bool


class Options(NamedTuple):
    """Numbers of `PaperScheme` by its names, codes instead of words. Passed as a record."""

    kernel: int
    normalisation: float
    kernel_variance: float
    smoothing: int
    smoothing_tolerance: float
    smoothing_iterations: int
    discards: bool  # particles whose smoothing lengths do not settle
    up_to_date: bool  # are the smoothing lengths, at the first step
    integrator: int
    relative_cfl: bool
    c_cfl: float
    dt_max: float
    c_diffusion: float
    search: int
    bypass: bool
    c_nns: float
    k_bypass_max: int
    buffer: int
    buffer_min: int
    looks_ahead: bool
    parallel: bool
    pause_after: int


class Progress(NamedTuple):
    """Where a march is and what it has counted, and what one step leaves to the next. Passed as a record."""

    t: float  # seconds
    t1: float  # to march to
    steps: int = 0
    evaluations: int = 0
    searches: int = 0
    bypassed: int = 0
    smoothing_failed: int = 0
    culprit: int = 0  # the particle that a failure was seen at
    dt: float = 1.0  # the last step's
    shortest: float = 0.0  # step that counts as one
    longest: float = 0.0  # smoothing length: no support is beyond half a period
    known: bool = False  # is rho h^n
    follows: bool = False  # does h, before the next step
    must_search: bool = True  # in the next step
    k_bypass: int = 0  # steps since the last search
    elapsed: float = 0.0  # seconds since then
    t_ref: float = 0.0  # bypass time at that search


class Work(NamedTuple):
    """Arrays that one step leaves to the next."""

    grad: np.ndarray  # (N, n)
    v: np.ndarray  # (N, n)
    D: np.ndarray  # (1, n n) or (N, n n)
    divergence: np.ndarray  # (N, n) of D
    support: np.ndarray  # (N,) K h at the last search
    reach: np.ndarray  # (N,) radius the lists were made for
    h_before: np.ndarray  # (N,) smoothing lengths of the step before
    settled: np.ndarray  # (N,) bool, are the smoothing lengths


#: Numba's types of `Cloud`, `Near`, a record of `Options`, and `Work`.
CLOUD = types.NamedTuple([MATRIX, VECTOR, VECTOR, VECTOR, VECTOR], Cloud)
NEAR = types.NamedTuple([VIEW, types.Tuple([types.int64[::1], types.int32[::1]]), VECTOR], Near)
OPTIONS = type_of(Options)
WORK = types.NamedTuple([MATRIX] * 4 + [VECTOR] * 3 + [types.boolean[::1]], Work)


@jit
def room_for(cloud, equations, options):
    """The `Work` of a march that begins; D is filled in where it is constant."""
    N, n = cloud.x.shape
    K = RADIUS[options.kernel]
    varies = equations.time_dependent or equations.state_dependent
    D = np.empty((N if varies else 1, n * n))
    if not varies:
        for a in range(n):
            for b in range(n):
                D[0, a * n + b] = equations.D[a, b]
    vectors = (np.empty((N, n)), np.empty((N, n)), D, np.empty((N, n)))
    return Work(*vectors, K * cloud.h, 1.3 * K * cloud.h, cloud.h.copy(), np.ones(N, np.bool_))
