"""Functions by address: a compiled loop is entered in a microsecond, not sixty for each function.

Numba looks a jitted function up in its tables every time one is passed from Python as a first-class value.
Its addresses never change, so they are looked up once and passed as numbers; compiled code makes them a value
of a function's type again. Exceptions come through as ever.

The large parts of a compiled loop come the same way. Where compiled code calls a jitted function by name,
that function and all it calls are linked in and optimised once more, at every level: by address they are
compiled once.
"""

from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ._jit import BATCH, BATCH_FUNCTION

__all__ = ["ADDRESS", "Entry", "address_of", "addresses", "function_at"]

#: Type of what `address_of` returns: entry for compiled callers, entry for C.
ADDRESS = types.UniTuple(types.uint64, 2)

_KNOWN = WeakKeyDictionary()


class Entry:
    """A jitted function that other compiled code enters by address.

    Parameters
    ----------
    function : dispatcher
    arguments : tuple
        Numba types; an `Entry` where a function of its type is passed.
    """

    def __init__(self, function, arguments):
        self._function, self._given = function, arguments
        self.at = _function_of(lambda: self.type)

    @property
    def type(self):
        """Type of the function as a value; compiles or loads it."""
        return types.FunctionType(_compiled(self._function, self._arguments).signature)

    @cached_property
    def address(self):
        """The two addresses; compiles or loads the function."""
        return _addresses(_compiled(self._function, self._arguments))

    @property
    def _arguments(self):
        return tuple([a.type if isinstance(a, Entry) else a for a in self._given])


def _compiled(function, arguments):
    if arguments not in function.overloads:
        function.compile(arguments)
    return function.overloads[arguments]


def _addresses(compiled):
    names = compiled.fndesc.llvm_func_name, compiled.fndesc.llvm_cfunc_wrapper_name
    return tuple(np.uint64(compiled.library.get_pointer_to_function(name)) for name in names)


def address_of(function):
    """Return the two addresses of an `Entry` or of a jitted function of signature `BATCH`.

    The function must outlive their use.
    """
    if isinstance(function, Entry):
        return function.address
    if function not in _KNOWN:
        _KNOWN[function] = _addresses(_compiled(function, BATCH.args))
    return _KNOWN[function]


def addresses(kind, *functions):
    """Return a named tuple of a kind that holds the addresses of functions, as `address_of` takes them."""
    return kind(*[address_of(function) for function in functions])


def _function_of(type_of):
    """Make what turns addresses into a first-class function of a type, in compiled code."""

    @intrinsic
    def at(typing_context, addresses):
        type_ = type_of()

        def codegen(context, builder, signature, arguments):
            function = cgutils.create_struct_proxy(type_)(context, builder)
            pointer = context.get_value_type(types.voidptr)
            compiled, c = (builder.extract_value(arguments[0], i) for i in range(2))
            function.jit_addr = builder.inttoptr(compiled, pointer)
            function.c_addr = builder.inttoptr(c, pointer)
            function.py_addr = context.get_constant_null(types.voidptr)
            return function._getvalue()

        return type_(ADDRESS), codegen

    return at


#: Makes addresses a model's function.
function_at = _function_of(lambda: BATCH_FUNCTION)
