"""The command line: ``python -m experiments list``, ``run``, ``sweep``, ``benchmark`` and the others."""

import sys
from contextlib import contextmanager

from .terminal.interruption import stoppable


def main(argv=None):
    """Run a command and return its exit code; see `commands.main`."""
    with _complete():
        from . import commands

        return commands.main(argv)


def _load():
    """Import what is asked for: that takes seconds, in which Ctrl-C is to be answered already."""
    with _complete():
        from . import commands

        commands.load(sys.argv[1:])


@contextmanager
def _complete():
    """Say which package is missing, if one is."""
    try:
        yield
    except ModuleNotFoundError as problem:
        if problem.name.startswith(("experiments", "reference_filters", "sphfilter")):
            raise  # a mistake of ours
        need = f"error: the experiments need {problem.name}, which is not installed"
        raise SystemExit(f'{need}: pip install -e ".[experiments]"') from None


if __name__ == "__main__":
    sys.exit(stoppable(_load, main))
