"""Arrays as compiled code takes them; and such as own nothing: lent ones, and parts cheaper than a slice."""

import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from ._jit import MATRIX, VECTOR


def as_compiled(x):
    """An array as functions are compiled for, dense and not read-only: a copy where it is not such.

    Of any other kind they would be compiled once more, in the middle of a run.
    """
    return np.require(x, requirements="CW")


@intrinsic
def lent(typing_context, value):
    """An argument of a function, an array or a tuple that may hold some, as one that owns nothing.

    Whatever takes an array, or a part of one, counts who holds it, by atomic instructions of 5 ns each: a
    tenth of a record's time, measured. What is lent nobody counts: the caller keeps it for as long as the
    call takes, so that it must be an argument, and may not be returned.
    """

    def codegen(context, builder, signature, arguments):
        return _without_owner(builder, signature.args[0], arguments[0])

    return value(value), codegen


def _without_owner(builder, kind, value):
    if isinstance(kind, types.Array):  # who holds its memory comes first
        return builder.insert_value(value, value.type.elements[0](None), 0)
    for k, own in enumerate(kind if isinstance(kind, types.BaseTuple) else ()):
        part = _without_owner(builder, own, builder.extract_value(value, k))
        value = builder.insert_value(value, part, k)
    return value


@intrinsic
def rows_at(typing_context, numbers, at, K, n):
    """Numbers (K n,) from index `at` on as rows (K, n), for as long as the caller keeps the whole."""

    def codegen(context, builder, signature, arguments):
        whole, at, K, n = arguments
        data = context.make_array(signature.args[0])(context, builder, whole).data
        rows = context.make_array(MATRIX)(context, builder)
        size = context.get_constant(types.intp, 8)
        populate_array(
            rows,
            builder.gep(data, [at]),
            shape=[K, n],
            strides=[builder.mul(n, size), size],
            itemsize=size,
            meminfo=None,
        )
        return rows._getvalue()

    return MATRIX(numbers, types.intp, types.intp, types.intp), codegen


@intrinsic
def flat(typing_context, rows):
    """Rows of numbers (K, n) one after the other, (K n,), for as long as the caller keeps them."""

    def codegen(context, builder, signature, arguments):
        whole = context.make_array(signature.args[0])(context, builder, arguments[0])
        numbers, size = context.make_array(VECTOR)(context, builder), context.get_constant(types.intp, 8)
        shape = [whole.nitems]
        populate_array(numbers, data=whole.data, shape=shape, strides=[size], itemsize=size, meminfo=None)
        return numbers._getvalue()

    return VECTOR(rows), codegen


@intrinsic
def stretch(typing_context, rows, a, first, size):
    """Numbers (size,) of row a of an array (n, N) from one on, for as long as the caller keeps the whole.

    A loop over them becomes vector code: its index is never below zero.
    """

    def codegen(context, builder, signature, arguments):
        rows, a, first, size = arguments
        whole = context.make_array(signature.args[0])(context, builder, rows)
        length = builder.extract_value(whole.shape, 1)
        numbers, width = context.make_array(VECTOR)(context, builder), context.get_constant(types.intp, 8)
        at = builder.gep(whole.data, [builder.add(builder.mul(a, length), first)])
        populate_array(numbers, data=at, shape=[size], strides=[width], itemsize=width, meminfo=None)
        return numbers._getvalue()

    return VECTOR(rows, types.intp, types.intp, types.intp), codegen
