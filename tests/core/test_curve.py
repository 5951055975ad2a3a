"""Points along Hilbert's curve, and noise whose end is known."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.core._addresses import address_of
from sphfilter.core.paths.blocks import move_blocks
from sphfilter.core.paths.curve import along_curve
from sphfilter.core.paths.step_length import PLATEN, SHIFTED_PATH
from sphfilter.model.domain import Domain


@pytest.mark.parametrize(("n", "bits"), [(1, 16), (2, 8), (3, 5), (4, 4)])
def test_the_curve_goes_from_each_cell_to_a_neighbour(n, bits):
    """It passes every cell once."""
    side = 2**bits
    cells = np.stack(np.meshgrid(*[np.arange(side)] * n, indexing="ij"), axis=-1).reshape(-1, n)
    place = along_curve(((cells + 0.5) / side - 0.5) * 8.0, np.zeros(n), np.eye(n))
    order = np.argsort(place)
    assert len(np.unique(place)) == len(cells)
    assert np.abs(np.diff(cells[order], axis=0)).sum(axis=1).max() == 1


@pytest.mark.parametrize("steps", [PLATEN, SHIFTED_PATH])
def test_noise_ends_where_it_is_said_to_and_wanders_on_the_way(steps):
    """Without drift a path ends where its noise does; a second state sums up where it has been."""
    model = sf.SDE.from_expressions(["x", "s"], ["0", "x"], [["1"], ["0"]], [[0.5]])
    N, T = 5000, 2.0
    ends = np.random.default_rng(1).standard_normal((1, N))
    x, alive, report = np.zeros((N, 2)), np.ones(N, bool), np.zeros((-(-N // 256), 2))
    entries = address_of(model.drift_batch), address_of(model.noise_batch)
    constants = model.p, np.ones(2), np.sqrt(model.spectral_density)
    limits, codes = (0.1, 0.1, np.inf, 1e6), Domain(None, None).codes
    which = np.arange(len(report))
    move_blocks()(x, alive, ends, report, which, (0.0, T), limits, entries, constants, codes, (steps, 7))
    np.testing.assert_allclose(x[:, 0], np.sqrt(0.5 * T) * ends[0], atol=1e-12)
    between = x[:, 1] - 0.5 * T * x[:, 0]  # of a bridge: the variance of its integral is Q T^3 / 12
    assert abs(between.mean()) < 4.0 * between.std() / np.sqrt(N)
    assert between.var() == pytest.approx(0.5 * T**3 / 12.0, rel=0.1)
