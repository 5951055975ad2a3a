"""Noise of compiled steps: few values a step, normals where they show.

Variables of few values whose first moments are the normal's leave the weak order of a step as it is
(Kloeden & Platen 1992, section 14.2) and cost a fraction. But from a narrow start a few such steps lead to
lumps: the moments are right, the density is not, and a sharp reading finds one lump or none. So the first and
the last step of a row have normals, two for each noise. At two times, they smooth whatever the other steps
have led to, in a position and its velocity: lumps are 1.5 roots of a step apart, and one normal leaves 1e-4
of their contrast.
"""

import numpy as np
from numba import njit

from sphfilter.core._jit import jit

#: Bits of a word that one noise takes: a number below 2¹⁸, and three signs. Three noises share a word, whose
#: lowest bit is weak and not used.
BITS, NOISES = 21, 3
#: Four values of the moments of a normal up to the seventh: ±`_INNER`, and ±`_OUTER` with this chance.
#: With a chance of 18 bits the second and the fourth are exact, the sixth is off by 1e-5.
_RARE = round((3.0 - 6.0**0.5) / 6.0 * 2**18) / 2**18
_OUTER = (1.0 + (2.0 * (1.0 - _RARE) / _RARE) ** 0.5) ** 0.5
_INNER = (1.0 - (2.0 * _RARE / (1.0 - _RARE)) ** 0.5) ** 0.5
_LOW, _LIMIT = np.uint64(2**18 - 1), np.uint64(_RARE * 2**18)
_FIRST, _SECOND, _THIRD = np.uint64(1 << 18), np.uint64(1 << 19), np.uint64(1 << 20)
#: Normals are made in single precision, a third of the time: a number of 31 bits gives the radius of two, at
#: most 6.6; 32 bits the angle, the sign of the cosine, and whether sine and cosine change places.
_SINGLE = np.float32
_MANTISSA, _EXPONENT_0, _AFTER = np.uint32(0x007FFFFF), np.uint32(0x3F800000), np.uint32(23)
_NEGATIVE, _SWAPPED = np.uint32(1 << 31), np.uint32(1 << 30)
_HALF, _1, _1_5, _2, _126, _127 = (_SINGLE(k) for k in (0.5, 1.0, 1.5, 2.0, 126.0, 127.0))
_ROOT_2, _LN_2, _QUARTER, _SCALE = (_SINGLE(k) for k in (2.0**0.5, np.log(2.0), 0.5 * np.pi, 2.0**-31))
_LOG, _SINE = [tuple(_SINGLE(1 / k) for k in row) for row in ((3, 5, 7), (6, 120, 5040))]
_COSINE = tuple(_SINGLE(1 / k) for k in (2, 24, 720, 40320))
_OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}


@njit(**_OPTIONS)
def unit_noise(bits):
    """Increment and area of a step, of variance one, and a sign, from 21 bits."""
    W = _OUTER if (bits & _LOW) < _LIMIT else _INNER
    W = W if bits & _FIRST else -W
    return W, 1.0 if bits & _SECOND else -1.0, 1.0 if bits & _THIRD else -1.0


@jit
def _next_words(lanes, words):
    """Fill a word a lane; xorshift128+ (Vigna 2017), whose state, lanes[:2], moves on."""
    for i in range(words.size):
        a, b = lanes[0, i], lanes[1, i]
        a ^= a << np.uint64(23)
        c = a ^ b ^ (a >> np.uint64(17)) ^ (b >> np.uint64(26))
        lanes[0, i], lanes[1, i] = b, c
        words[i] = b + c


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _fill_normals(words, one, two):
    """Fill two rows (N,) of single precision with standard normals (Box & Muller 1958), off by at most 1e-6.

    Of the words (N,) the first half is for the radii, the second for the angles. As in `_normals` polynomials
    take the places of logarithm, sine and cosine.
    """
    halves, N = words.view(np.uint32), one.size
    radii, angles = halves[:N], halves[N:]
    for i in range(N):
        u = _SINGLE(_SINGLE(np.int32(radii[i] >> np.uint32(1))) + _1) * _SCALE
        bits = _SINGLE(u).view(np.uint32)
        m = np.uint32((bits & _MANTISSA) | _EXPONENT_0).view(np.float32)
        big = m > _ROOT_2
        octaves = _SINGLE(np.int32(bits >> _AFTER)) - (_126 if big else _127)
        m = _HALF * m if big else m
        s = (m - _1) / (m + _1)
        q = s * s
        log = octaves * _LN_2 + _2 * s * (_1 + q * (_LOG[0] + q * (_LOG[1] + q * _LOG[2])))
        radius = np.sqrt(-_2 * log)
        bits = angles[i]
        a = (np.uint32((bits & _MANTISSA) | _EXPONENT_0).view(np.float32) - _1_5) * _QUARTER
        q = a * a
        sine = radius * a * (_1 - q * (_SINE[0] - q * (_SINE[1] - q * _SINE[2])))
        cosine = _COSINE[1] - q * (_COSINE[2] - q * _COSINE[3])
        cosine = radius * (_1 - q * (_COSINE[0] - q * cosine))
        cosine = -cosine if bits & _NEGATIVE else cosine
        swapped = bits & _SWAPPED
        one[i] = sine if swapped else cosine
        two[i] = cosine if swapped else sine


@jit
def fill_noise(lanes, noise):
    """Fill increments and areas of one step, in turn, of each noise, with normals of variance one.

    Parameters
    ----------
    lanes : ndarray of uint64, shape (3, LANES)
        Generators, which move on, and a row of scratch.
    noise : ndarray of float32, shape (2 noises, LANES)
    """
    for k in range(0, noise.shape[0], 2):
        _next_words(lanes, lanes[2])
        _fill_normals(lanes[2], noise[k], noise[k + 1])
