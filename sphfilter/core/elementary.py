"""Sine, cosine, exponential, logarithm and hyperbolic tangent without branches or calls: vector code.

Those of the C library are called state by state: five to fifteen times the time. Polynomials are those of
fdlibm, Taylor's for the exponential, and Lambert's fraction; errors are below 1e-15, and of angles an ulp of
the angle. Angles from 1e15 on, whose sine means nothing, have that of zero.
"""

import math
from types import ModuleType

import numpy as np
from numba import njit

_OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}
#: Added to a number and taken away again it rounds it; in between, the lowest bits are the whole number's.
#: From 2^52 on numbers are whole, and half as much more keeps negative ones from falling below it.
_ROUNDING = 1.5 * 2.0**52
_PER_QUARTER, _PER_OCTAVE = 2.0 / math.pi, math.log2(math.e)
#: π/2 and ln 2 in parts (fdlibm) of 32 bits, of which multiples up to 2^21 are exact; sums are off by 1e-26.
_QUARTER = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_OCTAVE = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # ln 2 = their sum
#: The least number whose exponent has bits; over eps = 2^-52 any less is lifted to it, 2^-1074 to 2^-1022.
_NORMAL, _EPS, _LIFTED = float(np.finfo(float).tiny), float(np.finfo(float).eps), int(np.finfo(float).nmant)
#: The last whole numbers whose exponentials are normal, -708 and 709.
_LEAST, _MOST = float(math.ceil(math.log(_NORMAL))), float(math.floor(math.log(np.finfo(float).max)))
_ROOT_HALF = int(np.float64(math.sqrt(0.5)).view(np.int64))  # mantissas are between √½ and √2
_NEAR = 0.25  # to zero, where 1 - 2 / (exp(2 x) + 1) cancels; the fraction is right to 2e-16 up to a half


@njit(**_OPTIONS)
def _quarters(x):
    """Bits of the number of quarter turns in x, and sine and cosine of what is left."""
    turned = x * _PER_QUARTER + _ROUNDING
    q = turned - _ROUNDING
    r = x - q * _QUARTER[0] - q * _QUARTER[1] - q * _QUARTER[2]
    r = r if abs(r) < 1.0 else 0.0 * r
    z = r * r
    s = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
    s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s)
    c = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    c = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * c)
    sine = r + r * z * (-1.66666666666666324348e-01 + z * s)
    cosine = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * c)
    return np.float64(turned).view(np.int64), sine, cosine


@njit(**_OPTIONS)
def _sin(x):
    quarters, sine, cosine = _quarters(np.float64(x))
    size = cosine if quarters & 1 else sine
    return -size if quarters & 2 else size


@njit(**_OPTIONS)
def _cos(x):
    quarters, sine, cosine = _quarters(np.float64(x))
    size = sine if quarters & 1 else cosine
    return -size if (quarters + 1) & 2 else size


@njit(**_OPTIONS)
def _exp(x):
    turned = min(max(np.float64(x), _LEAST), _MOST) * _PER_OCTAVE + _ROUNDING
    k = turned - _ROUNDING
    r = min(max(np.float64(x), _LEAST), _MOST) - k * _OCTAVE[0] - k * _OCTAVE[1]
    p = 1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r * (1 / 39916800 + r / 479001600)))
    p = 1 / 24 + r * (1 / 120 + r * (1 / 720 + r * (1 / 5040 + r * p)))
    p = 1.0 + r * (1.0 + r * (1 / 2 + r * (1 / 6 + r * p)))
    value = p * np.int64((np.float64(turned).view(np.int64) << 52) + (1023 << 52)).view(np.float64)
    value = np.inf if x > _MOST else value
    value = 0.0 if x < _LEAST else value
    return value if x == x else np.float64(x)


@njit(**_OPTIONS)
def _log(x):
    x = np.float64(x)
    small = x < _NORMAL
    bits = np.float64(x / _EPS if small else x).view(np.int64)
    k = (bits - _ROOT_HALF) >> 52
    f = np.int64(bits - (k << 52)).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = 3.999999999940941908e-01 + z * (2.857142874366239149e-01 + z * 2.222219843214978396e-01)
    q = 1.818357216161805012e-01 + z * (1.531383769920937332e-01 + z * 1.479819860511658591e-01)
    p = z * (6.666666666666735130e-01 + z * (p + z * z * z * q))
    half = 0.5 * f * f
    e = np.float64(k - _LIFTED if small else k)
    value = e * _OCTAVE[0] - ((half - (s * (half + p) + e * _OCTAVE[1])) - f)
    value = value if x < np.inf else x
    return value if x > 0.0 else (-np.inf if x == 0.0 else np.nan)


@njit(**_OPTIONS)
def _tanh(x):
    x = np.float64(x)
    z = x * x
    near = x * (135135.0 + z * (17325.0 + z * (378.0 + z)))
    near /= 135135.0 + z * (62370.0 + z * (3150.0 + 28.0 * z))
    return near if abs(x) < _NEAR else 1.0 - 2.0 / (_exp(2.0 * x) + 1.0)


#: What numpy has, with the functions of this module in their places. numpy 1 keeps `abs` out of its list.
FAST = ModuleType("numpy_in_lanes")
FAST.__dict__.update({name: getattr(np, name) for name in ("abs", *np.__all__) if name != "__version__"})
FAST.__dict__.update({"sin": _sin, "cos": _cos, "exp": _exp, "log": _log, "tanh": _tanh})
