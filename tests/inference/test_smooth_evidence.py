"""The log-evidence as a function of a parameter: nothing that lattices decide may show."""

import numpy as np
from oscillators import DUFFING, POSITION

import sphfilter as sf


def test_the_log_evidence_is_smooth_in_a_parameter():
    """Jumps are below 1e-3 nat: the distance from a quartic through values a thousandth apart."""
    times = np.arange(0.0, 17.0, 2.0)
    _, z = sf.simulate(DUFFING, POSITION, x0=[3.0, 0.0], times=times, rng=1)

    def log_evidence(c):
        start = {"x0": [3.0, 0.0], "P0": np.diag([0.2, 1.0]), "n_particles": 400}
        return float(np.sum(sf.SPHFilter(DUFFING.with_parameters(c=c), POSITION, **start)
                            .run(times[1:], z[1:]).log_evidence))  # fmt: skip

    change = np.linspace(-0.01, 0.01, 21)
    values = np.array([log_evidence(0.4 * (1.0 + k)) for k in change])
    smooth = np.polynomial.Polynomial.fit(change, values, 4)
    assert np.ptp(values) > 1e-3
    assert np.abs(values - smooth(change)).max() < 1e-3
