"""Log-density between particles that lie on no lattice: a quadratic through the neighbours of each."""

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["interpolant"]

_NEIGHBORS_A_TERM = 2.0
_NEAR = 1.5  # distances to the nearest neighbour, up to which a quadratic is taken as it is


def interpolant(x, log_p, factor):
    """Return a function of states X (M, n) that gives log p (M,).

    Each state gets the weighted least-squares quadratic of the particle nearest to it in whitened coordinates;
    away from all particles its concave part alone, never rising.

    Parameters
    ----------
    x, log_p : ndarray, shape (N, n), (N,)
    factor : ndarray, shape (n, n)
        Lower factor of the covariance that whitens.
    """
    whiten = np.linalg.inv(factor).T
    z = x @ whiten
    N, n = z.shape
    pairs = np.triu_indices(n)
    terms = n + len(pairs[0])
    K = min(int(_NEIGHBORS_A_TERM * terms) + 2, N - 1)
    tree = cKDTree(z)
    distance, neighbors = tree.query(z, K + 1)
    d = z[neighbors[:, 1:]] - z[:, None]
    basis = np.concatenate([d, d[..., pairs[0]] * d[..., pairs[1]]], axis=-1)
    reach = distance[:, -1:]
    weight = np.exp(-2.0 * (distance[:, 1:] / reach) ** 2)[..., None]
    scale = np.concatenate([np.repeat(reach, n, 1), np.repeat(reach**2, terms - n, 1)], axis=1)[:, None]
    normal = np.einsum("ikp,ikq->ipq", basis / scale * weight, basis / scale)
    normal += 1e-8 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(terms)
    right = np.einsum("ikp,ik->ip", basis / scale * weight, log_p[neighbors[:, 1:]] - log_p[:, None])
    c = np.linalg.solve(normal, right[..., None])[..., 0] / scale[:, 0]
    gradient, H = c[:, :n], np.zeros((N, n, n))
    H[:, pairs[0], pairs[1]] = c[:, n:] * np.where(pairs[0] == pairs[1], 2.0, 1.0)
    H[:, pairs[1], pairs[0]] = H[:, pairs[0], pairs[1]]
    w, V = np.linalg.eigh(H)
    concave = np.einsum("iab,ib,icb->iac", V, np.minimum(w, 0.0), V)
    near = _NEAR * distance[:, 1]

    def log_density(X):
        Y = np.atleast_2d(X) @ whiten
        r, j = tree.query(Y)
        d = Y - z[j]
        slope = np.einsum("ia,ia->i", d, gradient[j])
        inside = slope + 0.5 * np.einsum("ia,iab,ib->i", d, H[j], d)
        outside = np.minimum(slope + 0.5 * np.einsum("ia,iab,ib->i", d, concave[j], d), 0.0)
        return log_p[j] + np.where(r <= near[j], inside, outside)

    return log_density
