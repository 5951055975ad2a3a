"""A grid of one state whose tails are as exact as its peak, however small they are."""

import numpy as np

__all__ = ["filtered_by_tail_grid"]


def filtered_by_tail_grid(drift, noise, variance, start, times, readings, nodes):
    """Means, variances and log-evidences (K,) of dX = drift(X) dt + noise dW, read with Gaussian noise.

    Probabilities go to neighbours at the rates of Scharfetter and Gummel, and are summed over the number of
    jumps, of which each keeps all numbers positive: nothing cancels, unlike in steps of an implicit rule,
    whose rounding leaves 1e-16 of a peak everywhere. `start` is a mean and a variance, readings are (K,).
    """
    d = 14.0 / nodes
    x = -7.0 + d * (np.arange(nodes) + 0.5)
    D, v = 0.5 * noise**2, drift(x[:-1] + 0.5 * d)
    up, down = (D / d**2 * _bernoulli(sign * v * d / D) for sign in (-1.0, 1.0))
    p, t, found = np.exp(-0.5 * (x - start[0]) ** 2 / start[1]), 0.0, []
    for t1, z in zip(times, readings, strict=True):
        p, t = _moved(p / p.sum(), up, down, t1 - t), t1
        log_l = -0.5 * (z - x) ** 2 / variance - 0.5 * np.log(2.0 * np.pi * variance)
        log_p = np.log(np.maximum(p, 1e-320)) + log_l
        p = np.exp(log_p - log_p.max())
        mean = p @ x / p.sum()
        found.append((mean, p @ (x - mean) ** 2 / p.sum(), log_p.max() + np.log(p.sum())))
    return np.array(found).T


def _bernoulli(y):
    """y / (exp(y) - 1)."""
    small = np.abs(y) < 1e-9
    return np.where(small, 1.0 - 0.5 * y, y / np.expm1(np.where(small, 1.0, y)))


def _moved(p, up, down, dt):
    """Probabilities p after a time, by the number of jumps of a clock that is faster than all rates."""
    out = np.append(up, 0.0) + np.append(0.0, down)
    fast = 1.0001 * out.max()
    stay, up, down = 1.0 - out / fast, up / fast, down / fast
    parts = int(fast * dt / 500.0) + 1
    mean = fast * dt / parts
    for _ in range(parts):
        log_w, now, total = -mean, p, np.exp(-mean) * p
        for jump in range(1, int(mean + 12.0 * np.sqrt(mean) + 40.0)):
            moved = stay * now
            moved[1:] += up * now[:-1]
            moved[:-1] += down * now[1:]
            now, log_w = moved, log_w + np.log(mean / jump)
            total = total + np.exp(log_w) * now
        p = total
    return p
