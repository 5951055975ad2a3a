"""Ctrl-C, answered as by the library's own command, whose module is loaded without the library.

That takes seconds to import, in which Ctrl-C is to be answered already.
"""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

_SPEC = spec_from_file_location(
    f"{__name__}.of_library", Path(find_spec("sphfilter").origin).parent / "command" / "interruption.py"
)
_MODULE = module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)
stoppable = _MODULE.stoppable
