"""The time loop of the log-density scheme: from lattice to lattice along backward stochastic characteristics.

The FPK equation dp/dt = -div(f p) + D:grad grad p of additive noise is solved exactly by (Feynman-Kac)

    p(y, t + tau) = E[ p(Y, t) exp(-int div f ds) ],     Y the end of dY = -f ds + g dW from y, back to t,

and the expectation by a few weighted paths of the noise. Each path is a Runge-Kutta step of an ordinary
equation (002 has no counterpart: there the diffusion velocity is summed over neighbours, with explicit
limits on the step). Weights and densities are positive, so no step can become unstable; what limits tau is
accuracy.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from ._first_class import function_at
from ._jit import jit, parallel_jit
from .field import (
    LOWEST,
    UNKNOWN,
    build_field,
    eigen,
    evaluate,
    frontier,
    invert_lower,
    marked,
    opened,
    product,
    slopes,
)

__all__ = ["COUNTERS", "LOCAL", "MOST_ASKED", "MOST_CELLS", "STATUS", "Control", "Noise", "Paths", "march"]

STATUS = ("ok", "not finite", "paused", "stalled", "too few nodes", "outgrown", "lost")
OK, NOT_FINITE, PAUSED, STALLED, TOO_FEW, OUTGROWN, LOST = range(7)
COUNTERS = ("steps", "rejected", "evaluations", "relaid")
STEPS, REJECTED, EVALUATIONS, RELAID = range(4)
_MARGIN = 3  # cells around the seeds in the first box
MOST_CELLS = 20_000_000
_TRIES = 6
MOST_ASKED = 12  # cells asked for, over the number of particles wanted
LOCAL = 0.9  # variance within pieces, over that of the whole, below which lattices follow the pieces
_STEP_LOSS = 0.13  # of all that may be lost, from which a step is tried again in halves
_SMALLER = 2  # times a step that loses probability is halved
_MOST_PARTS = 16  # Runge-Kutta steps from lattice to lattice
_FILL = 0.85  # nodes aimed at, over those allowed
_SURE = 1.0  # nats below the last level kept, from which one path will do
_FAR = 6.0  # standard deviations of the noise
_BLOCK = 256  # states that one thread takes at a time


class Noise(NamedTuple):
    """D = G G^T / 2 per second; asked of the model at mid-step where it depends on time."""

    G: np.ndarray  # (n, m)
    p: np.ndarray  # parameters of the model
    time_dependent: bool
    constant_divergence: bool


class Paths(NamedTuple):
    """Weighted paths of the noise over a step of length one: straight to dW, bent to enclose the area."""

    log_weight: np.ndarray  # (Q,)
    w: np.ndarray  # (Q, 2 m): dW, then bends


class Aim(NamedTuple):
    """Noise of a path back from y given where y is: a Gaussian, exact for a Gaussian density and linear paths."""

    B: np.ndarray  # (n, 2 m) response of a path's end to its noise, in units of the lattice
    root: np.ndarray  # (N, 2 m, 2 m) lower; its transpose times standard normals has the Gaussian's spread
    log_det: np.ndarray  # (N,)


class Control(NamedTuple):
    """What the march aims at."""

    n_particles: int
    depth: float  # Z^2 / 2: log p of the lightest nodes below that of the heaviest
    tolerance: float  # of one step's paths, in standard deviations
    noise_share: float  # largest variance a step's noise may have, in units of the density's own
    pause_after: int
    bent_share: float
    curved: float
    most_lost: float  # sum over steps of |log of the lattice's integral| at which to stop


@jit
def along(drift, divergence, noise, x, f1, d1, t, h, parts, straight, bend, end, action):
    """Paths from states x (M, n) at time t to t + h, h of either sign, by `parts` Runge-Kutta steps.

    Noise displaces them on the way, by u straight + 6 u (1 - u) bend after a part u of the time, both (M, n).
    `f1` and `d1` are drift and divergence at the start; `action`, shape (M,), takes the integral of the
    divergence unless that is None.
    """
    M, n = x.shape
    y, z, f, step = np.empty((M, n)), x.copy(), f1.copy(), h / parts
    for i in range(M):
        for a in range(n):
            end[i, a] = x[i, a]
        if divergence is not None:
            action[i] = 0.0
    if divergence is not None:
        d = d1.copy()
    for stage in range(4 * parts):
        k = stage % 4
        u = (stage // 4 + (0.0 if k == 0 else 1.0 if k == 3 else 0.5)) / parts
        if stage > 0:
            drift(y, t + u * h, noise.p, f)
            if divergence is not None and not noise.constant_divergence:
                divergence(y, t + u * h, noise.p, d)
        c = step / 6.0 if k in (0, 3) else step / 3.0
        ahead, v = (step if k == 2 else 0.5 * step), u + (0.5 / parts if k in (0, 2) else 0.0)
        for i in range(M):
            if divergence is not None:
                action[i] += c * d[i, 0]
            for a in range(n):
                end[i, a] += c * f[i, a]
                if k == 3:
                    z[i, a] = end[i, a]
                shift = v * straight[i, a] + 6.0 * v * (1.0 - v) * bend[i, a]
                y[i, a] = z[i, a] + shift + (ahead * f[i, a] if k < 3 else 0.0)
    for i in range(M):
        for a in range(n):
            end[i, a] += straight[i, a]


@jit
def _displace(G, h, w, straight, bend):
    """Displacements (n,) of a path whose noise is w (2 m,): straight parts, then bends."""
    m = G.shape[1]
    for a in range(straight.size):
        straight[a] = bend[a] = 0.0
        for k in range(m):
            straight[a] += G[a, k] * math.sqrt(h) * w[k]
            bend[a] += G[a, k] * math.sqrt(h / 12.0) * w[m + k]


@jit
def aimed(drift, noise, field, y, t1, h, parts):
    """Where the noise of paths back from t1 goes, given where they start: see `Aim`.

    y: (n,) state around which the response of the paths' ends to their noise is measured.
    """
    n, K = field.mu.size, 2 * noise.G.shape[1]
    M = 2 * K
    Y, straight, bend, end = np.empty((M, n)), np.empty((M, n)), np.empty((M, n)), np.empty((M, n))
    f, w = np.empty((M, n)), np.empty(K)
    for k in range(M):
        for a in range(n):
            Y[k, a] = y[a]
        for j in range(K):
            w[j] = 0.0
        w[k // 2] = 1.0 if k % 2 else -1.0
        _displace(noise.G, h, w, straight[k], bend[k])
    drift(Y, t1, noise.p, f)
    along(drift, None, noise, Y, f, f, t1, -h, parts, straight, bend, end, w)
    B = np.zeros((n, K))
    for a in range(n):
        for k in range(K):
            for c in range(n):
                B[a, k] += field.inverse[a, c] * 0.5 * (end[2 * k + 1, c] - end[2 * k, c])
    N = field.node.shape[0]
    root, log_det = np.zeros((N, K, K)), np.zeros(N)
    R = np.empty((K, K))
    HB = np.empty((n, K))
    precision = np.empty((K, K))
    for i in range(N):
        if field.tail[i, 0, 0] != 0.0:  # a complete node
            for a in range(n):
                for k in range(K):
                    HB[a, k] = 0.0
                    for c in range(n):
                        HB[a, k] += field.tail[i, a, c] * B[c, k]
            for k in range(K):
                for j in range(K):
                    v = 1.0 if j == k else 0.0
                    for a in range(n):
                        v -= B[a, j] * HB[a, k]
                    precision[j, k] = v
            cholesky(precision, R)
            root[i] = invert_lower(R)
            for k in range(K):
                log_det[i] -= math.log(R[k, k])
    return Aim(B, root, log_det)


@jit
def back(drift, divergence, noise, field, sten, paths, aim, Y, t1, h, parts, floor, out):
    """log p(Y, t1), shape (M,), from the field at t1 - h.

    Where one path to the middle of the noise finds log p well below `floor`, that has to do.
    """
    M, n = Y.shape
    K = aim.B.shape[1]
    f1, d1 = np.empty((M, n)), np.empty((M, 1))
    straight, bend, end, action = np.zeros((M, n)), np.zeros((M, n)), np.empty((M, n)), np.zeros(M)
    owner, slope, centre = np.empty(M, np.int64), np.empty((M, n)), np.zeros((M, K))
    drift(Y, t1, noise.p, f1)
    divergence(Y, t1, noise.p, d1)
    if K > 0:
        along(drift, None, noise, Y, f1, d1, t1, -h, parts, straight, bend, end, action)
        slopes(field, sten, end, owner, slope)
        _centres(aim, owner, slope, centre)
        for i in range(M):
            _displace(noise.G, h, centre[i], straight[i], bend[i])
    along(drift, divergence, noise, Y, f1, d1, t1, -h, parts, straight, bend, end, action)
    evaluate(field, sten, end, out)
    for i in range(M):
        out[i] += action[i]
        for k in range(K):
            out[i] -= 0.5 * centre[i, k] ** 2
        if K > 0:
            out[i] += aim.log_det[owner[i]]
    if K > 0:
        high = _above(out, floor - _SURE)
        out[high] = _expected(drift, divergence, noise, field, sten, paths, aim, Y[high], f1[high], d1[high],
                              centre[high], owner[high], t1, h, parts)  # fmt: skip


@jit
def _above(values, level):
    """Numbers of the values above a level."""
    found, count = np.empty(values.size, np.int64), 0
    for i in range(values.size):
        if not values[i] <= level:
            found[count] = i
            count += 1
    return found[:count]


@jit
def _expected(
    drift, divergence, noise, field, sten, paths, aim, Y, f1, d1, centre, owner, t1, h, parts
):  # fmt: skip
    """Logarithm of the expectation over the paths back from states Y (M, n)."""
    M, n = Y.shape
    K = centre.shape[1]
    straight, bend, end, w = np.empty((M, n)), np.empty((M, n)), np.empty((M, n)), np.empty(K)
    action, tilt, log_p = np.empty(M), np.empty(M), np.empty(M)
    highest, total = np.full(M, -np.inf), np.zeros(M)
    for q in range(paths.log_weight.size):
        for i in range(M):
            tilt[i] = aim.log_det[owner[i]]
            for k in range(K):
                w[k] = centre[i, k]
                for j in range(k, K):
                    w[k] += aim.root[owner[i], j, k] * paths.w[q, j]
                tilt[i] += 0.5 * (paths.w[q, k] ** 2 - w[k] ** 2)
            _displace(noise.G, h, w, straight[i], bend[i])
        along(drift, divergence, noise, Y, f1, d1, t1, -h, parts, straight, bend, end, action)
        evaluate(field, sten, end, log_p)
        for i in range(M):
            v = log_p[i] + action[i] + paths.log_weight[q] + tilt[i]
            if not v > LOWEST:
                v = LOWEST
            if v > highest[i]:
                total[i] = total[i] * math.exp(highest[i] - v) + 1.0
                highest[i] = v
            else:
                total[i] += math.exp(v - highest[i])
    for i in range(M):
        total[i] = highest[i] + math.log(total[i])
    return total


@jit
def _centres(aim, owner, slope, centre):
    """The noise that leads to where the density is, as far as a quadratic knows; at most _FAR from zero."""
    n, K = aim.B.shape
    g, r = np.empty(K), np.empty(K)
    for i in range(owner.size):
        size = 0.0
        for k in range(K):
            g[k] = 0.0
            for a in range(n):
                g[k] += aim.B[a, k] * slope[i, a]
        for k in range(K):
            r[k] = 0.0
            for j in range(k + 1):
                r[k] += aim.root[owner[i], k, j] * g[j]
        for k in range(K):
            for j in range(k, K):
                centre[i, k] += aim.root[owner[i], j, k] * r[j]
            size += centre[i, k] ** 2
        if not size <= _FAR**2:
            for k in range(K):
                centre[i, k] = centre[i, k] * _FAR / math.sqrt(size) if math.isfinite(size) else 0.0


@parallel_jit
def back_in_blocks(drift, divergence, noise, field, sten, paths, aim, Y, t1, h, parts, floor, out):
    """As `back`, blocks of states spread over threads: a state's value does not depend on the
    block it is in.
    """
    for block in prange((Y.shape[0] + _BLOCK - 1) // _BLOCK):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, Y.shape[0])
        back(drift, divergence, noise, field, sten, paths, aim, Y[first:last], t1, h, parts, floor, out[first:last])


@jit
def _refactor(diffusion, x, t, noise):
    """G of D = G G^T / 2 at time t, its columns the axes of D; noise that does not depend on the state."""
    n = x.shape[1]
    D = np.empty((1, n * n))
    diffusion(x[:1], t, noise.p, D)
    w, V = np.empty(n), np.empty((n, n))
    eigen(D.reshape((n, n)), w, V)
    for k in range(noise.G.shape[1]):
        largest = 0
        for a in range(n):
            largest = a if w[a] > w[largest] else largest
        for a in range(n):
            noise.G[a, k] = V[a, largest] * math.sqrt(2.0 * max(w[largest], 0.0))
        w[largest] = -np.inf


@jit
def moments(x, m, mean, cov):
    """Mean and covariance of weighted points."""
    N, n = x.shape
    for a in range(n):
        mean[a] = 0.0
        for i in range(N):
            mean[a] += m[i] * x[i, a]
    for a in range(n):
        for b in range(a + 1):
            c = 0.0
            for i in range(N):
                c += m[i] * (x[i, a] - mean[a]) * (x[i, b] - mean[b])
            cov[a, b] = cov[b, a] = c


@jit
def cholesky(P, L):
    """Lower factor; semi-definite directions get a spread of 1e-12 of the largest. False if not finite."""
    n = P.shape[0]
    for a in range(n):
        for b in range(n):
            L[a, b] = 0.0
    for a in range(n):
        for b in range(a + 1):
            c = P[a, b]
            for k in range(b):
                c -= L[a, k] * L[b, k]
            if a == b:
                if not math.isfinite(c) or P[a, a] <= 0.0:
                    return False
                L[a, a] = math.sqrt(max(c, 1e-24 * P[a, a]))
            else:
                L[a, b] = c / L[b, b]
    return True


@jit
def _whiten(L, v):
    """v <- L^-1 v."""
    for a in range(v.size):
        for b in range(a):
            v[a] -= L[a, b] * v[b]
        v[a] /= L[a, a]


@jit
def noise_limit(G, L):
    """Largest eigenvalue, bounded by the trace, of L^-1 G G^T L^-T: variance per second, in the density's."""
    total, v = 0.0, np.empty(L.shape[0])
    for k in range(G.shape[1]):
        for a in range(v.size):
            v[a] = G[a, k]
        _whiten(L, v)
        for a in range(v.size):
            total += v[a] * v[a]
    return total


@jit
def _path_error(once, twice, m, L):
    """Mass-weighted rms distance of two results, in standard deviations; infinite if any is not finite."""
    total, v = 0.0, np.empty(L.shape[0])
    for i in range(m.size):
        for a in range(v.size):
            v[a] = once[i, a] - twice[i, a]
        _whiten(L, v)
        for a in range(v.size):
            total += m[i] * v[a] * v[a]
    return math.sqrt(total) if math.isfinite(total) else np.inf


@jit
def predicted(drift, noise, x, f, ahead, m, t, h, parts, mean, cov):
    """Mean and covariance after a step: of the cloud undisturbed, and pushed to and fro by every noise.

    Straight pushes and bent ones: their covariance with each other is what keeps a thin density from being
    taken for a still thinner one.
    """
    N, n = x.shape
    pushes = 4 * noise.G.shape[1]
    width = max(3.0, 0.5 * pushes)
    share = 0.5 / width
    X, M = np.empty(((pushes + 1) * N, n)), np.empty((pushes + 1) * N)
    for i in range(N):
        M[i] = m[i] * (1.0 - pushes * share)
        for a in range(n):
            X[i, a] = ahead[i, a]
    straight, bend, w = np.empty((N, n)), np.empty((N, n)), np.zeros(2 * noise.G.shape[1])
    for push in range(pushes):
        w[push // 2] = (1.0 if push % 2 else -1.0) * math.sqrt(width)
        for i in range(N):
            _displace(noise.G, h, w, straight[i], bend[i])
        w[push // 2] = 0.0
        first = (push + 1) * N
        along(drift, None, noise, x, f, f, t, h, parts, straight, bend, X[first : first + N], M)
        for i in range(N):
            M[first + i] = m[i] * share
    moments(X, M, mean, cov)
    return X


@jit
def bentness(X, m, L):
    """How far from linear paths' ends are in their noise of one standard deviation: mass-weighted rms of the
    second difference, in standard deviations of the density, all noises together.
    """
    N, n = m.size, X.shape[1]
    pushes = X.shape[0] // N - 1
    width = max(3.0, 0.5 * pushes)
    total, v = 0.0, np.empty(n)
    for push in range(0, pushes, 2):
        for i in range(N):
            for a in range(n):
                v[a] = 0.5 * (X[(push + 1) * N + i, a] + X[(push + 2) * N + i, a]) - X[i, a]
            _whiten(L, v)
            for a in range(n):
                total += m[i] * (v[a] / width) ** 2
    return math.sqrt(total)


@jit
def sheared(drift, noise, x, m, t, L):
    """Sum over the noises of |L^-1 J g|^2, mass-weighted mean: how fast the drift carries noise into
    directions without any.
    """
    N, n = x.shape
    y, f, g = np.empty((2 * N, n)), np.empty((2 * N, n)), np.empty(n)
    total, v = 0.0, np.empty(n)
    for k in range(noise.G.shape[1]):
        scale = 0.0
        for a in range(n):
            v[a] = noise.G[a, k]
        _whiten(L, v)
        for a in range(n):
            scale += v[a] * v[a]
        step = 1e-3 / math.sqrt(max(scale, 1e-300))  # a thousandth of a standard deviation along g
        for a in range(n):
            g[a] = step * noise.G[a, k]
        for i in range(N):
            for a in range(n):
                y[i, a], y[N + i, a] = x[i, a] - g[a], x[i, a] + g[a]
        drift(y, t, noise.p, f)
        for i in range(N):
            for a in range(n):
                v[a] = 0.5 * (f[N + i, a] - f[i, a]) / step
            _whiten(L, v)
            for a in range(n):
                total += m[i] * v[a] * v[a]
    return total


@jit
def furthest(n):
    """Cells around the origin that seeds may lie in: pieces of a density further out would be lost."""
    return max(500.0, min(1e6, 0.4 * MOST_CELLS ** (1.0 / n)))


@jit
def seeds_in_box(points, mu, inverse, reach, low, dims):
    """Box around the lattice cells of some points, and the flat numbers of those cells."""
    N, n = points.shape
    cells = np.empty((N, n), np.int64)
    for i in range(N):
        for a in range(n):
            t = 0.0
            for c in range(n):
                t += inverse[a, c] * (points[i, c] - mu[c])
            cells[i, a] = math.floor(min(max(t, -reach), reach) + 0.5)
    for a in range(n):
        low[a], dims[a] = cells[0, a], cells[0, a]
        for i in range(N):
            low[a], dims[a] = min(low[a], cells[i, a]), max(dims[a], cells[i, a])
        low[a] -= _MARGIN
        dims[a] += _MARGIN + 1 - low[a]
    return cells


@jit
def states_of(found, mu, A, low, dims):
    """States (M, n) of cells of a box, given by flat numbers; and their integer coordinates."""
    n = dims.size
    node, Y = np.empty((found.size, n), np.int64), np.empty((found.size, n))
    for k in range(found.size):
        rest = found[k]
        for a in range(n - 1, -1, -1):
            node[k, a] = rest % dims[a] + low[a]
            rest //= dims[a]
        for a in range(n):
            Y[k, a] = mu[a]
            for c in range(n):
                Y[k, a] += A[a, c] * node[k, c]
    return node, Y


@jit
def seeded(cells, low, dims):
    """Flat numbers of cells, each once."""
    mark = np.zeros(int(product(dims)), np.bool_)
    for i in range(cells.shape[0]):
        flat = 0
        for a in range(dims.size):
            flat = flat * dims[a] + cells[i, a] - low[a]
        mark[flat] = True
    return marked(mark)


@jit
def widen(value, low, dims, asked):
    """A larger box on every side; values and the list of asked cells are carried over. Empty if too large."""
    n = dims.size
    grow, new_low, new_dims = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for a in range(n):
        grow[a] = max(dims[a] // 4, 2)
        new_low[a], new_dims[a] = low[a] - grow[a], dims[a] + 2 * grow[a]
    if product(new_dims) > MOST_CELLS:
        return np.empty(0), new_low, new_dims, asked
    new, moved = np.full(int(product(new_dims)), UNKNOWN), np.empty_like(asked)
    for k in range(asked.size):
        rest, at, stride = asked[k], 0, 1
        for a in range(n - 1, -1, -1):
            at += (rest % dims[a] + grow[a]) * stride
            rest //= dims[a]
            stride *= new_dims[a]
        new[at], moved[k] = value[asked[k]], at
    return new, new_low, new_dims, moved


@jit
def joined(one, other):
    """Two lists of cells as one."""
    both = np.empty(one.size + other.size, np.int64)
    for k in range(one.size):
        both[k] = one[k]
    for k in range(other.size):
        both[one.size + k] = other[k]
    return both


@jit
def _flooded(drift, divergence, noise, field, sten, paths, aim, mu, A, points, t1, h, parts, control, counters, threads):
    """Values on the new lattice wherever they lie above the depth: seeds, then their neighbours,
    until closed.
    """
    n = mu.size
    ball = sten.offsets[: sten.size[0]]
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    cells = seeds_in_box(points, mu, invert_lower(A), furthest(n), low, dims)
    if product(dims) > MOST_CELLS:
        return np.empty(0), low, dims, 0.0, np.empty(0, np.int64)
    value, asked = np.full(int(product(dims)), UNKNOWN), np.empty(0, np.int64)
    found, highest = seeded(cells, low, dims), -np.inf
    while found.size > 0:
        _, Y = states_of(found, mu, A, low, dims)
        log_p = np.empty(found.size)
        if threads is None:  # by type, so that the branch not taken is not compiled
            back(drift, divergence, noise, field, sten, paths, aim, Y, t1, h, parts, highest - control.depth, log_p)
        else:
            back_in_blocks(drift, divergence, noise, field, sten, paths, aim, Y, t1, h, parts, highest - control.depth, log_p)
        counters[EVALUATIONS] += found.size * ((4 * parts - 1) * (paths.log_weight.size + 1) + 1)
        for k in range(found.size):
            value[found[k]] = log_p[k]
            highest = max(highest, log_p[k])
        asked = joined(asked, found)
        if asked.size > MOST_ASKED * control.n_particles:
            break  # far too fine a lattice: the caller takes a coarser one
        found, beyond = frontier(value, asked, highest - control.depth, dims, ball)
        if beyond:
            value, low, dims, asked = widen(value, low, dims, asked)
            if value.size == 0:
                break
            found, beyond = frontier(value, asked, highest - control.depth, dims, ball)
    return value, low, dims, highest, asked


@jit
def relaid(value, low, dims, highest, cells, mu, A, sten, depth):
    """The nodes of a flooded box above the depth, normalised.

    Mean, covariance and the integral are sums over all cells that were asked for, the ring just below the
    depth included: what the cut would take away from them is below rounding of what the lattice resolves.

    Returns
    -------
    node (N, n), x (N, n), log_p (N,), m (N,), log of the integral, mean (n,), covariance (n, n)
    """
    n = mu.size
    found = opened(value, cells, highest - depth, dims, sten.offsets[: sten.size[0]])
    node, x = states_of(found, mu, A, low, dims)
    asked = np.sort(cells)  # sums do not depend on the order in which the cells were found
    _, everywhere = states_of(asked, mu, A, low, dims)
    weight, total, cell = np.empty(asked.size), 0.0, 1.0
    for k in range(asked.size):
        weight[k] = math.exp(value[asked[k]] - highest)
        total += weight[k]
    for k in range(asked.size):
        weight[k] /= total
    for a in range(n):
        cell *= A[a, a]
    log_mass = highest + math.log(total * cell)
    mean, cov = np.empty(n), np.empty((n, n))
    moments(everywhere, weight, mean, cov)
    log_p, m, inside = np.empty(found.size), np.empty(found.size), 0.0
    for k in range(found.size):
        log_p[k] = value[found[k]] - log_mass
        m[k] = math.exp(value[found[k]] - highest)
        inside += m[k]
    for k in range(found.size):
        m[k] /= inside
    return node, x, log_p, m, log_mass, mean, cov


@jit
def nodes_of(field):
    """States (N, n) and masses of a field's nodes."""
    N, n = field.node.shape
    x, m, total = np.empty((N, n)), np.empty(N), 0.0
    for i in range(N):
        m[i] = math.exp(field.log_p[i])
        total += m[i]
        for a in range(n):
            x[i, a] = field.mu[a]
            for c in range(n):
                x[i, a] += field.A[a, c] * field.node[i, c]
    for i in range(N):
        m[i] /= total
    return x, m


@jit
def local_shape(field, m, L, Q):
    """Lower Q with which L Q whitens the density piece by piece, where L whitens it as a whole.

    (L Q)(L Q)^T is the inverse of the Fisher information E[grad log p (grad log p)^T]: the covariance of a
    Gaussian, and that within the pieces of a density in several, or across a bent one. Q is the identity
    unless the two differ by much.
    """
    n = L.shape[0]
    info, R, B = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    w, V, total = np.empty(n), np.empty((n, n)), 0.0
    for i in range(m.size):
        known = False
        for a in range(n):
            known |= field.coefficient[i, a] != 0.0
        if known:  # nodes at the rim have no polynomial
            total += m[i]
            for a in range(n):
                for b in range(n):
                    info[a, b] += m[i] * field.coefficient[i, a] * field.coefficient[i, b]
    inverse = invert_lower(L)
    for a in range(n):
        for b in range(n):
            info[a, b] /= total
            for k in range(n):
                B[a, b] += inverse[a, k] * field.A[k, b]
    eigen(info, w, V)
    for k in range(n):  # R = B info^-1 B^T
        for a in range(n):
            v = 0.0
            for b in range(n):
                v += B[a, b] * V[b, k]
            info[a, k] = v / math.sqrt(max(w[k], 1e-300))
    for a in range(n):
        for b in range(n):
            for k in range(n):
                R[a, b] += info[a, k] * info[b, k]
            Q[a, b] = 1.0 if a == b else 0.0
    for a in range(n):
        for b in range(n):
            B[a, b] = R[a, b]
    eigen(B, w, V)
    smallest = w[0]
    for k in range(n):
        smallest = min(smallest, w[k])
    if 0.0 < smallest < LOCAL:
        cholesky(R, Q)


@jit
def times_lower(L, Q, out):
    """out = L Q."""
    n = L.shape[0]
    for a in range(n):
        for b in range(n):
            out[a, b] = 0.0
            for k in range(n):
                out[a, b] += L[a, k] * Q[k, b]


@jit
def march(addresses, noise, field, sten, paths, control, times, state, counters, threads):
    """Carry a field from times[0] to times[1]; times[0], `state` and the counters are kept up to date.

    addresses: of the model's drift, divergence and D, so that it is entered without looking functions up.
    threads: None for one thread, True for as many as there are.
    state: [filled volume of the whitened lattice, next step, sum of |log mass| lost, longest step].
    Returns the field, its states and masses, their mean and covariance, and a code of `STATUS`. On failure
    they are as far as they came.
    """
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    diffusion = function_at(addresses[2])
    n = field.mu.size
    mean, P, L = np.empty(n), np.empty((n, n)), np.empty((n, n))
    Q, S = np.empty((n, n)), np.empty((n, n))
    x, m = nodes_of(field)
    span, first = times[1] - times[0], counters[STEPS]
    moments(x, m, mean, P)
    tried, before, coarse = 0, np.inf, False
    while times[0] < times[1]:
        if counters[STEPS] - first >= control.pause_after:
            return field, x, m, mean, P, PAUSED
        if not cholesky(P, L):
            return field, x, m, mean, P, NOT_FINITE
        local_shape(field, m, L, Q)
        times_lower(L, Q, S)
        t, left = times[0], times[1] - times[0]
        h = min(_MOST_PARTS * state[1], left, state[3], state[4])
        if noise.time_dependent:
            _refactor(diffusion, x, t + 0.5 * h, noise)
        limit = control.noise_share / max(noise_limit(noise.G, S), 1e-300)
        bent = control.bent_share / max(sheared(drift, noise, x, m, t, S), 1e-300)
        h = min(h, limit, bent ** (1.0 / 3.0))
        pieces = math.ceil(left / h - 1e-9)
        h = left if pieces <= 1 else (0.5 * left if pieces == 2 else h)
        parts = max(1, math.ceil(h / state[1] - 1e-9))
        once, twice, f, still = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.zeros_like(x)
        drift(x, t, noise.p, f)
        along(drift, None, noise, x, f, f, t, h, parts, still, still, once, m)
        along(drift, None, noise, x, f, f, t, h, 2 * parts, still, still, twice, m)
        counters[EVALUATIONS] += 12 * parts * x.shape[0]
        error = _path_error(once, twice, m, S) / control.tolerance
        factor = 5.0 if error == 0.0 else min(5.0, max(0.2, 0.9 * error**-0.25)) if error < np.inf else 0.1
        state[1] = min(h / parts * factor, 1e300)
        if error > 1.0:
            counters[REJECTED] += 1
            if state[1] < 1e-9 * span:
                return field, x, m, mean, P, (NOT_FINITE if error == np.inf else STALLED)
            continue
        mean_new, P_new = np.empty(n), np.empty((n, n))
        X = predicted(drift, noise, x, f, twice, m, t, h, parts, mean_new, P_new)
        counters[EVALUATIONS] += 16 * parts * noise.G.shape[1] * x.shape[0]
        if not cholesky(P_new, L):
            return field, x, m, mean, P, NOT_FINITE
        times_lower(L, Q, S)
        curved = bentness(X, m, S) / control.curved
        state[4] = h * min(3.0, max(0.2, 0.9 / math.sqrt(max(curved, 1e-6))))
        if curved > 1.0:
            counters[REJECTED] += 1
            continue
        mean_old, P_old = mean, P
        mean, P = mean_new, P_new
        aim = aimed(drift, noise, field, mean, t + h, h, parts)
        for attempt in range(_TRIES):
            spacing = (state[0] / (_FILL * control.n_particles)) ** (1.0 / n)
            A, origin = S.copy(), mean.copy()
            for a in range(n):
                for b in range(n):
                    A[a, b] *= spacing
            value, low, dims, highest, asked = _flooded(
                drift, divergence, noise, field, sten, paths, aim, origin, A, twice, t + h, h, parts,
                control, counters, threads,
            )  # fmt: skip
            if value.size == 0:
                return field, x, m, mean, P, OUTGROWN
            node, x_new, log_p, m_new, log_mass, mean, P = relaid(
                value, low, dims, highest, asked, origin, A, sten, control.depth
            )
            closed = asked.size <= MOST_ASKED * control.n_particles
            count = x_new.shape[0] if closed else asked.size
            if 0.5 * control.n_particles <= count <= control.n_particles:
                break
            counters[RELAID] += 1
            state[0] *= max(count, 0.1 * control.n_particles) / (_FILL * control.n_particles)
            if attempt == _TRIES - 1 and (count == 0 or count > control.n_particles):
                return field, x, m, mean, P, TOO_FEW
        lost = abs(log_mass)
        coarse |= lost > 0.5 * before  # a shorter step did not help: it is the lattice
        if lost > _STEP_LOSS * control.most_lost and tried < _SMALLER and not coarse:
            tried, before, state[4] = tried + 1, lost, 0.5 * h
            counters[REJECTED] += 1
            mean, P = mean_old, P_old
            continue
        tried, before = 0, np.inf
        state[0] = count * spacing**n
        state[2] += lost
        x, m = x_new, m_new
        field = build_field(origin, A, node, log_p, sten)
        counters[STEPS] += 1
        times[0] = times[1] if pieces <= 1 else t + h
        if not state[2] < control.most_lost:
            return field, x, m, mean, P, LOST
    return field, x, m, mean, P, OK

