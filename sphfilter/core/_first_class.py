"""Model functions by address: a compiled loop is entered in a microsecond, not sixty for each function.

Numba looks a jitted function up in its tables every time one is passed from Python as a first-class value.
Its addresses never change, so they are looked up once and passed as numbers; compiled code makes them a value
of type `BATCH_FUNCTION` again. Exceptions come through as ever.
"""

from weakref import WeakKeyDictionary

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ._jit import BATCH, BATCH_FUNCTION

__all__ = ["ADDRESS", "address_of", "function_at"]

#: Type of what `address_of` returns: entry for compiled callers, entry for C.
ADDRESS = types.UniTuple(types.uint64, 2)

_KNOWN = WeakKeyDictionary()


def address_of(function):
    """Return the two addresses of a jitted function of signature `BATCH`; it must outlive their use."""
    addresses = _KNOWN.get(function)
    if addresses is None:
        result = function.get_compile_result(BATCH)
        names = result.fndesc.llvm_func_name, result.fndesc.llvm_cfunc_wrapper_name
        addresses = tuple(result.library.get_pointer_to_function(name) for name in names)
        _KNOWN[function] = addresses
    return addresses


@intrinsic
def function_at(typing_context, addresses):
    """Return the first-class function of these addresses; for compiled code."""

    def codegen(context, builder, signature, arguments):
        function = cgutils.create_struct_proxy(BATCH_FUNCTION)(context, builder)
        pointer = context.get_value_type(types.voidptr)
        compiled, c = (builder.extract_value(arguments[0], i) for i in range(2))
        function.jit_addr = builder.inttoptr(compiled, pointer)
        function.c_addr = builder.inttoptr(c, pointer)
        function.py_addr = context.get_constant_null(types.voidptr)
        return function._getvalue()

    return BATCH_FUNCTION(ADDRESS), codegen
