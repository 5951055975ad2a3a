"""What `transient --help` ends with: the example of a file, and the keys of the thesis' input file."""

import inspect

from experiments.guide import end_of_help

_TEXT = end_of_help("transient")
EXAMPLE = inspect.cleandoc("\n" + _TEXT[_TEXT.index("  [model]") : _TEXT.index("Results are in")]) + "\n"
_TABLE = _TEXT[_TEXT.index("From the input file of the thesis") :].splitlines()[2:]
#: Left column of the table; the right one begins below that of its first line.
KEYS = [line[2 : _TABLE[0].index("--out")].strip() for line in _TABLE if line.strip()]
