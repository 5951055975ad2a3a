"""Arrays as compiled code takes them; and parts of one as arrays that own nothing, cheaper than a slice."""

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
