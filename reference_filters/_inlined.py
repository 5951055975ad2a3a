"""Steps of a model's paths with its drift compiled into them: one pass over a block of states a step.

A block holds its states axis by axis, (n, B), so that the compiler turns the pass into vector code. A model's
drift takes rows of states: it is called on a row on the stack, inlined, and the row becomes registers. Noise
is made of random bits on the way, or given (`_lane_noise`).
"""

import math
from functools import lru_cache

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from sphfilter.core._addresses import Entry
from sphfilter.core._jit import MATRIX, VECTOR
from sphfilter.model.paths import noise_root

from ._lane_noise import BITS, NOISES, unit_noise
from ._weights import LANES

_REAL, _CUBE = types.float64, types.float64[:, :, ::1]
_STEP = (MATRIX, types.uint64[:, ::1], types.float32[:, ::1], _REAL, _CUBE, _REAL, _REAL, VECTOR)
_TRIAL = (MATRIX, _CUBE, _REAL, _REAL, VECTOR, _CUBE)
#: What a loop makes functions of, from their addresses: `step(x, lanes, given, own, sigma, t, h, p)` moves a
#: block x (n, B), `trial(x, sigma, t, h, p, work)` fills work (3, n, B); see `compiled`.
NEW_STEP, NEW_TRIAL = Entry(None, _STEP, types.void).at, Entry(None, _TRIAL, types.void).at

#: Bytes of a drift's bytecode below which it is put into the step wherever it is asked for, seven times.
_SHORT = 8000
_OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}}  # multiply-adds save a third
_NAMES = {f"U{k}": np.uint64(k) for k in range(64)} | {"unit_noise": unit_noise, "np": np}


def fits(model):
    """Whether steps can be compiled: the noise does not depend on the state, the drift is no Python code."""
    code = model.drift_batch.py_func.__code__
    return not model.state_dependent_noise and not {*code.co_names, *code.co_freevars} & {"ask", "again"}


def pattern_of(model):
    """Which noises (m) move which states (n), as n tuples of truth values: zeros are left out of the code."""
    if model.inputs or not model.autonomous:
        return ((True,) * model.n_noise,) * model.dim
    sigma = model.noise(np.zeros((1, model.dim)), 0.0)[0] @ noise_root(model.spectral_density)
    return tuple(tuple(row) for row in (sigma != 0.0).tolist())


@lru_cache(maxsize=64)
def compiled(drift, pattern, order):
    """Addresses of the step and of the trial step of a drift; half a second for each drift and process.

    The step is from t over h seconds, with σ = g L (3, n, m) at its begin, middle and end, and parameters p;
    its noise is `own` times what it draws from the generators plus the one that is given, see `fill_noise`.
    The trial fills what `_additive_trial` of `_step_length` does.

    Parameters
    ----------
    drift : dispatcher
        A model's `drift_batch`.
    pattern : tuple
        Of `pattern_of`.
    order : {2, 4}
        2: half the noise, classical Runge-Kutta along the drift, half the noise (Strang); 4: the path of
        `sde_steps.shifted_path_steps`, of weak order 3 as measured.

    Returns
    -------
    step, trial : Entry
        They must outlive the use of their addresses.
    """
    n, short = len(pattern), len(drift.py_func.__code__.co_code) < _SHORT
    inlined = njit(drift.py_func, forceinline=short, **_OPTIONS)
    sizes = {"block": _sized(n, LANES), "blocks": _sized(3, n, LANES), "generators": _sized(3, LANES),
             "noises": _sized(2 * len(pattern[0]), LANES)}  # fmt: skip
    moves = _words(len(pattern[0])) + _noise(pattern, order) + _runge_kutta(pattern, order)
    names = _NAMES | {"drift": inlined, "row": _row(n), **sizes}
    step = "\n    ".join([
        "def step(x, lanes, given, own, sigma, t, h, p):", "y, k, root = row(), row(), np.sqrt(h)",
        "x, lanes, given = block(x), generators(lanes), noises(given)",
        *_roots(pattern, 3), f"for i in range({LANES}):",
        *(f"    {line}" for line in moves),
    ])  # fmt: skip
    trial = "\n    ".join([
        "def trial(x, sigma, t, h, p, work):", "y, k, root = row(), row(), 1.0 / np.sqrt(h)",
        "x, work = block(x), blocks(work)",
        *_roots(pattern, 1), f"for i in range({LANES}):", *(f"    {line}" for line in _trial(pattern)),
    ])  # fmt: skip
    for source in (step, trial):
        exec(source, names)
    return tuple(
        Entry(njit(names[name], **_OPTIONS), arguments, types.void)
        for name, arguments in (("step", _STEP), ("trial", _TRIAL))
    )


def _row(n):
    """Compiled code's function that gives a row of n numbers, (1, n), on the stack."""

    @intrinsic
    def row(typing_context):
        def codegen(context, builder, signature, arguments):
            numbers = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), n))
            data = builder.bitcast(numbers, ir.DoubleType().as_pointer())
            return _array_at(context, builder, MATRIX, data, (1, n))

        return MATRIX(), codegen

    return row


def _sized(*shape):
    """Compiled code's function that gives an array with a shape that is known as code is compiled.

    Then the compiler sees that the rows of a block do not overlap, and need not ask at each call.
    """

    @intrinsic
    def sized(typing_context, array):
        def codegen(context, builder, signature, arguments):
            data = context.make_array(array)(context, builder, arguments[0]).data
            return _array_at(context, builder, array, data, shape)

        return array(array), codegen

    return sized


def _array_at(context, builder, kind, data, shape):
    """An array of 8-byte numbers at a pointer, that owns nothing."""
    at = context.make_array(kind)(context, builder)
    sizes = [context.get_constant(types.intp, size) for size in shape]
    strides = [context.get_constant(types.intp, 8 * math.prod(shape[d + 1 :])) for d in range(len(shape))]
    item = context.get_constant(types.intp, 8)
    populate_array(at, data, shape=sizes, strides=strides, itemsize=item, meminfo=None)
    return at._getvalue()


def _roots(pattern, times):
    """Lines that take σ out of its array: it cannot change on the way, which the compiler does not know."""
    return [f"s{j}_{a}_{k} = sigma[{j}, {a}, {k}]" for j in range(times) for a, k in _entries(pattern)]


def _entries(pattern):
    return [(a, k) for a, row in enumerate(pattern) for k, moved in enumerate(row) if moved]


def _words(m):
    """Lines of the generator, xorshift128+ (Vigna 2017): 21 bits e0, e1, ... for each of m noises."""
    lines, n_words = ["a, b = lanes[0, i], lanes[1, i]"], -(-m // NOISES)
    for j in range(n_words):
        lines += ["a ^= a << U23", "c = a ^ b ^ (a >> U17) ^ (b >> U26)", f"a, b, w{j} = b, c, b + c"]
    lines.append("lanes[0, i], lanes[1, i] = a, b")
    return lines + [f"e{k} = w{k // NOISES} >> U{1 + BITS * (k % NOISES)}" for k in range(m)]


def _noise(pattern, order):
    """Lines of the step's path of noise: jump j_k, slope r_k over h, jump l_k, of noise k of unit density."""
    beside, half = ("np.sqrt(h / 12.0)", "half * c") if order == 4 else ("half", "half * W")
    lines = ["half, per = 0.5 * root, 1.0 / root", f"beside = {beside}"]
    for k in range(len(pattern[0])):
        lines += [f"W, H, c = unit_noise(e{k})", f"W = own * W + given[{2 * k}, i]",
                  f"c, H = {half}, beside * (own * H + given[{2 * k + 1}, i])",
                  f"j{k}, r{k}, l{k} = c + H, per * (W - per * (c + c)), c - H"]  # fmt: skip
    return lines


def _sums(pattern, name, times):
    """Lines of σ times a noise at every state, zeros left out: `{name}{j}_{a}` for each time j."""
    lines = []
    for j in times:
        for a, row in enumerate(pattern):
            terms = [f"s{j}_{a}_{k} * {name}{k}" for k, moved in enumerate(row) if moved]
            lines.append(f"{name}{j}_{a} = {' + '.join(terms) or '0.0'}")
    return lines


def _asked(n, state, factor, slope, time):
    """Lines that ask for the drift at `state` + factor times what k holds, and add the noise's slope."""
    shift = f" + {factor} * k[0, {{a}}]" if factor else ""
    lines = [f"y[0, {a}] = {state}{a}{shift.format(a=a)}" for a in range(n)]
    lines.append(f"drift(y, {time}, p, k)")
    return lines + [f"k[0, {a}] += {slope}_{a}" for a in range(n) if slope]


def _runge_kutta(pattern, order):
    """Lines of a step: a jump, classical Runge-Kutta along drift and slopes, a jump."""
    n, rises = len(pattern), order == 4
    lines = _sums(pattern, "j", [0]) + _sums(pattern, "l", [2]) + _sums(pattern, "r", range(3 * rises))
    lines += [f"q{a} = x[{a}, i] + j0_{a}" for a in range(n)]
    slopes = [f"r{j}" if rises else "" for j in range(3)]
    lines += _asked(n, "q", "", slopes[0], "t") + [f"v{a} = k[0, {a}]" for a in range(n)]
    for _ in range(2):
        lines += _asked(n, "q", "0.5 * h", slopes[1], "t + 0.5 * h")
        lines += [f"v{a} += 2.0 * k[0, {a}]" for a in range(n)]
    lines += _asked(n, "q", "h", slopes[2], "t + h")
    return lines + [f"x[{a}, i] = q{a} + h / 6.0 * (v{a} + k[0, {a}]) + l2_{a}" for a in range(n)]


def _trial(pattern):
    """Lines that fill the change h (k₃ − k₂) of a Runge-Kutta step, its move h k₃, and bend h (k₂ − k₁)."""
    n, m = len(pattern), len(pattern[0])
    lines = [f"r{k} = root if (i >> {k % 8}) & 1 else -root" for k in range(m)]
    lines += _sums(pattern, "r", [0]) + [f"q{a} = x[{a}, i]" for a in range(n)]
    lines += _asked(n, "q", "", "r0", "t") + [f"v{a} = k[0, {a}]" for a in range(n)]
    lines += _asked(n, "q", "0.5 * h", "r0", "t + 0.5 * h")
    for a in range(n):
        lines += [f"u{a} = k[0, {a}]", f"work[2, {a}, i] = h * (u{a} - v{a})"]
    lines += _asked(n, "q", "0.5 * h", "r0", "t + 0.5 * h")
    for a in range(n):
        lines += [f"work[0, {a}, i] = h * (k[0, {a}] - u{a})", f"work[1, {a}, i] = h * k[0, {a}]"]
    return lines
