"""Model functions passed by address: same values, exceptions come through."""

import numpy as np
import pytest
from numba import types

from sphfilter.core._addresses import ADDRESS, address_of, function_at
from sphfilter.core._jit import jit_for
from sphfilter.model.compile import surfacing
from sphfilter.model.sde import SDE

_MATRIX, _VECTOR = types.float64[:, ::1], types.float64[::1]


def _filled(address, x, p, out):
    function_at(address)(x, 0.5, p, out)


FILLED = jit_for(types.void(ADDRESS, _MATRIX, _VECTOR, _MATRIX), _filled)
X = np.array([[0.3, -1.2], [2.0, 0.1]])


def test_two_models_through_one_compiled_function():
    for c in (0.4, 2.0):
        model = SDE(lambda x, t, p: (x[1], -p[0] * x[1] - t * x[0]), 2, parameters={"c": c})
        out = np.empty((2, 2))
        FILLED(address_of(model.drift_batch), X, model.p, out)
        np.testing.assert_array_equal(out, model.drift(X, 0.5))


def test_exceptions_come_through():
    def careful(X, t):
        if X[0, 0] > 1.0:
            raise ValueError("too far")
        return X

    model, out = SDE(careful, 2, vectorized=True), np.empty((2, 2))
    FILLED(address_of(model.drift_batch), X, model.p, out)
    np.testing.assert_array_equal(out, X)
    with pytest.raises(ValueError, match="too far"), surfacing():
        FILLED(address_of(model.drift_batch), X + 2.0, model.p, out)
