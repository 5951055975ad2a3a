"""A function that compiled code alone calls is linked into its callers, and machine code of theirs alone.

Numba makes each jitted function machine code of its own, with all that it calls, also where nothing but
another jitted function calls it: what lies five calls deep is optimised and translated five times. Here such
a function stays as it is written, in LLVM's terms, until Python calls it or somebody asks for its address;
then it is compiled as ever. Numba has no switch for it: `install` puts subclasses in the place of its
classes, which do what those do wherever no `Jitted` function is being compiled. README's example on an empty
cache takes .55 of the time that way (seconds of the processor, measured in turn).
"""

import ctypes
import sys
from contextlib import contextmanager

from llvmlite.binding import parse_bitcode
from numba import _dynfunc
from numba.core import event, sigutils
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler_lock import global_compiler_lock
from numba.core.cpu import CPUContext
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher, cpu_target

_KIND = "linked"  # of what is kept on disk: numba's are "object" and "bitcode"
_ENVIRONMENT = "_ZN08NumbaEnv"  # as names of environments begin, by numba's mangling
#: Address of what Python would call: it returns NULL, of which Python makes a `SystemError`.
_NOBODY = ctypes.cast(ctypes.pythonapi.PyErr_Occurred, ctypes.c_void_p).value


class _Waiting(event.Listener):
    """The functions that are being compiled, each waiting for the next; and whether a `Jitted` one does."""

    def __init__(self):
        self.stack = [(None, False)] * 2  # nothing waits for what is compiled without a word, as ufuncs are

    def on_start(self, event):
        function = event.data["dispatcher"]
        self.stack.append((function, isinstance(function, Jitted) or self.inside))

    def on_end(self, event):
        if len(self.stack) > 2:  # else it began before anybody listened
            self.stack.pop()

    @property
    def inside(self):
        """Whether what is compiled next is for a `Jitted` function, which waits for it."""
        return self.stack[-1][1]

    def links(self, fndesc):
        """Whether the function that is being made is for a `Jitted` one alone."""
        (_, asked), (function, inside) = self.stack[-2:]
        if isinstance(function, Jitted) and fndesc.qualname == function.py_func.__qualname__:
            return asked
        exported = getattr(sys.modules.get(fndesc.modname), fndesc.qualname, None) is function  # to Python
        return inside and fndesc.modname.partition(".")[0] == "numba" and not exported


_WAITING = _Waiting()


@contextmanager
def alone():
    """Compile what comes within as if nothing waited for it."""
    with global_compiler_lock:
        _WAITING.stack.append((None, False))
        try:
            yield
        finally:
            _WAITING.stack.pop()


def is_linked(library):
    """Whether the code of a function's library is part of others alone."""
    return getattr(library, "linked", False)  # numba's own library where it was made before


class _Library(JITCodeLibrary):
    """Numba's library of a function's code; a linked one is not machine code of its own."""

    linked = False

    def _optimize_final_module(self):
        if not self.linked:
            super()._optimize_final_module()

    def _finalize_final_module(self):
        if self.linked:
            self._finalize_dynamic_globals()
            self._finalized = True
        else:
            super()._finalize_final_module()

    def serialize_using_object_code(self):
        if not self.linked:
            return super().serialize_using_object_code()
        return self.name, _KIND, self._final_module.as_bitcode()

    @classmethod
    def _unserialize(cls, codegen, state):
        name, kind, data = state
        if kind != _KIND:
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.linked, library._final_module = True, parse_bitcode(data)
        library._finalize_final_module()
        return library


class _Codegen(JITCPUCodegen):
    """Numba's code generator; the environments of linked code wait for what it is linked into."""

    _library_class = _Library

    def set_env(self, env_name, env):
        if self._engine.is_symbol_defined(env_name):
            super().set_env(env_name, env)


class _Cache(FunctionCache):
    """Numba's, in which a function that Python calls is not found as a linked one."""

    def load_overload(self, sig, target_context):
        found = super().load_overload(sig, target_context)
        return None if found is not None and is_linked(found.library) and not _WAITING.inside else found


class Jitted(CPUDispatcher):
    """Numba's jitted function, which may be linked; Python finds it compiled."""

    def enable_caching(self):
        self._cache = _Cache(self.py_func)

    def add_overload(self, cres):
        if is_linked(cres.library):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)

    def compile(self, sig):
        with global_compiler_lock:
            if not _WAITING.inside:
                self._forget(sig)
            return super().compile(sig)

    def _forget(self, sig):
        """Let go of the linked code of a signature."""
        arguments = tuple(sigutils.normalize_signature(sig)[0])
        if arguments in self.overloads and is_linked(self.overloads[arguments].library):
            del self.overloads[arguments]


class _Context(CPUContext):
    """Numba's, which makes nothing for calls from outside of a function that compiled code alone calls."""

    def create_cpython_wrapper(self, library, fndesc, *arguments, **options):
        if not _WAITING.links(fndesc):
            super().create_cpython_wrapper(library, fndesc, *arguments, **options)

    def create_cfunc_wrapper(self, library, fndesc, *arguments, **options):
        if not _WAITING.links(fndesc):
            super().create_cfunc_wrapper(library, fndesc, *arguments, **options)

    def get_executable(self, library, fndesc, env):
        if not library._finalized and _WAITING.links(fndesc):
            library.linked = True
            library.finalize()
        if is_linked(library):
            name = fndesc.qualname.rpartition(".")[2]
            return _dynfunc.make_function(fndesc.lookup_module(), name, "linked", _NOBODY, env, (library,))
        found = super().get_executable(library, fndesc, env)
        for variable in library._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                environment = lookup_environment(variable.name)
                if environment is not None:  # of a function that is linked into this one
                    library.codegen.set_env(variable.name, environment)
        return found


_Context.__module__, _Context.__name__ = CPUContext.__module__, CPUContext.__name__  # told in users' messages


def install():
    """Let numba link what it compiles for `Jitted` functions."""
    event.register("numba:compile", _WAITING)
    context = cpu_target.target_context
    context.__class__, context.codegen().__class__ = _Context, _Codegen
