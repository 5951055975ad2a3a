"""Models, and how far moments are from exact ones."""

import numpy as np

import sphfilter as sf
from sphfilter import consistency

#: T4: particles at most by dimension.
COUNTS = {1: 100, 2: 200, 3: 400, 4: 800}
DUFFING = ["v", "-0.4*v - x*(0.1*x**2 - 1)"]


def linear(n):
    """A damped linear model of n states, noise in the last alone from two on."""
    A = {
        1: [[-0.5]],
        2: [[0, 1], [-1, -0.4]],
        3: [[-0.5, 1, 0], [-1, -0.5, 0.3], [0, 0.2, -0.8]],
        4: [[0, 1, 0, 0], [-2, -0.3, 1, 0.1], [0, 0, 0, 1], [1, 0.1, -2, -0.3]],
    }[n]
    noise = np.eye(n)[:, [k for k in range(n) if n != 2 or k == 1]]
    noise = noise[:, [1, 3]] if n == 4 else noise
    return sf.LinearSDE(A=A, noise=noise, spectral_density=0.4 * np.eye(noise.shape[1]))


def position(n, R=0.3):
    return sf.GaussianMeasurement(h=np.eye(1, n), noise_cov=[[R]])


def start(n):
    return np.linspace(1.0, 0.0, n), 0.3 * np.eye(n) + 0.1


def whitened(P, exact_P):
    """L⁻¹ (P − exact_P) L⁻ᵀ with exact_P = L Lᵀ, over the leading axes."""
    L = np.linalg.cholesky(exact_P)
    half = np.linalg.solve(L, P - exact_P)
    return np.linalg.solve(L, np.swapaxes(half, -1, -2))


def off(x, P, exact_x, exact_P):
    """Norm of the whitened mean error, and of the whitened covariance error over sqrt(n)."""
    cov = np.linalg.norm(whitened(P, exact_P), axis=(-2, -1)) / np.sqrt(np.shape(x)[-1])
    return consistency.distance(x, exact_x, exact_P), cov


def moved(model, mean, cov, t, N, config=None):
    return sf.predict(sf.initialize(sf.Gaussian(mean, cov), N), model, t, config)


def text(states, drift, noise=(("0",), ("1",)), Q=((1.0,),), **parameters):
    return sf.SDE.from_expressions(states, drift, noise, Q, parameters)


def duffing(Q=0.5):
    return text(["x", "v"], DUFFING, Q=[[Q]])


def drifting(velocity, noise=0.2):
    return sf.LinearSDE([[0.0]], [velocity], noise=[[noise]])


def moving(rates=((-0.1, 0.1), (0.2, -0.2))):
    """Rest, and motion of unit velocity."""
    return sf.JumpMarkovModel({"rest": drifting(0.0), "moving": drifting(1.0)}, rates)


def quadrature(p, n_nodes=400):
    """Nodes and weights over six deviations around a density of two states."""
    u = np.linspace(-6, 6, n_nodes)
    root = np.linalg.cholesky(p.cov())
    X = p.mean() + np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2) @ root.T
    w = p.pdf(X) * (u[1] - u[0]) ** 2 * np.prod(np.diag(root))
    return X, w
