"""A model file of one state that is read as it is, and what it makes of readings: for commands."""

import numpy as np

A, Q, R, M0, P0 = 0.4, 0.5, 0.3, 1.0, 2.0
TANK = f"""
[model]
states = ["x"]
labels = ["level"]
units = ["m"]
drift = ["-a*x"]
noise = [["1"]]
spectral_density = [[{Q}]]
parameters = {{ a = {A} }}
[sensor]
h = [[1.0]]
noise_cov = [[{R}]]
[start]
mean = [{M0}]
cov = [[{P0}]]
"""


def textbook(times, readings, t0=0.0):
    """Times, means, deviations and log-evidences (T, 4) of the scalar recursion; None is no reading."""
    m, P, t, rows = M0, P0, t0, []
    for t1, z in zip(times, readings, strict=True):
        decay = np.exp(-A * (t1 - t))
        m, P, t = decay * m, decay**2 * P + Q / (2 * A) * (1 - decay**2), t1
        evidence = 0.0
        if z is not None:
            S = P + R
            evidence = -0.5 * ((z - m) ** 2 / S + np.log(2 * np.pi * S))
            m, P = m + P / S * (z - m), P - P**2 / S
        rows.append((t1, m, np.sqrt(P), evidence))
    return np.array(rows)
