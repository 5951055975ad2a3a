"""Functions by address: a compiled loop is entered in a microsecond, not sixty for each function.

Numba looks a jitted function up in its tables every time one is passed from Python as a first-class value.
Its address never changes, so it is looked up once and passed as a number; compiled code makes it a value
of a function's type again. Exceptions come through as ever.

The large parts of a compiled loop come the same way. Where compiled code calls a jitted function by name,
that function and all it calls are linked in and optimised once more, at every level: by address they are
compiled once.
"""

from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ._jit import BATCH, BATCH_FUNCTION
from ._linking import alone, is_linked

#: Type of what `address_of` returns.
ADDRESS = types.uint64
#: Stands for a function that is not called.
NOWHERE_AT: Any = ADDRESS(0)

_KNOWN = WeakKeyDictionary()


class Entry:
    """A jitted function that other compiled code enters by address.

    Parameters
    ----------
    function : dispatcher
    arguments : tuple
        Numba types; an `Entry` where a function of its type is passed.
    returns : type, optional
        Numba's, of what the function returns. Where it is given, compiled code that may call the function
        does not wait for it to be compiled: what is never called never is.
    """

    def __init__(self, function, arguments, returns=None):
        self._function, self._given, self._returns = function, arguments, returns
        self.at = _function_of(lambda: self.type)

    @property
    def type(self):
        """Type of the function as a value; compiles or loads it, unless what it returns is known."""
        if self._returns is not None:
            return types.FunctionType(self._returns(*self._arguments))
        return types.FunctionType(_compiled(self._function, self._arguments).signature)

    @cached_property
    def address(self):
        """The address; compiles or loads the function."""
        compiled = _compiled(self._function, self._arguments)
        assert self._returns in (None, compiled.signature.return_type)
        return _address(compiled)

    @property
    def _arguments(self):
        return tuple([a.type if isinstance(a, Entry) else a for a in self._given])


def _compiled(function, arguments):
    found = function.overloads.get(arguments)
    if found is None or is_linked(found.library):
        with alone():
            function.compile(arguments)
    return function.overloads[arguments]


def _address(compiled):
    return np.uint64(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def address_of(function):
    """Return the address of an `Entry` or of a jitted function of signature `BATCH`.

    The function must outlive its use.
    """
    if isinstance(function, Entry):
        return function.address
    if function not in _KNOWN:
        _KNOWN[function] = _address(_compiled(function, BATCH.args))
    return _KNOWN[function]


def addresses(kind, *functions):
    """Return a named tuple of a kind that holds the addresses of functions, as `address_of` takes them.

    None stands for a function that is not called, and not compiled.
    """
    return kind(*[NOWHERE_AT if function is None else address_of(function) for function in functions])


def _function_of(type_of):
    """Make what turns an address into a first-class function of a type, in compiled code."""

    @intrinsic
    def at(typing_context, address):
        type_ = type_of()

        def codegen(context, builder, signature, arguments):
            function = cgutils.create_struct_proxy(type_)(context, builder)
            pointer = context.get_value_type(types.voidptr)
            function.jit_addr = builder.inttoptr(arguments[0], pointer)
            function.c_addr = function.py_addr = context.get_constant_null(types.voidptr)
            return function._getvalue()

        return type_(ADDRESS), codegen

    return at


#: Makes an address a model's function.
function_at = _function_of(lambda: BATCH_FUNCTION)
