"""The command line: ``python -m experiments list``, ``run``, ``sweep``, ``benchmark`` and the others."""

import sys

from .terminal.interruption import stoppable

__all__ = ["main"]


def main(argv=None):
    """Run a command and return its exit code; see `commands.main`."""
    return _commands().main(argv)


def _commands():
    try:
        from . import commands

        commands.load(sys.argv[1:])  # takes seconds, in which Ctrl-C is to be answered already
    except ModuleNotFoundError as problem:
        if problem.name.startswith(("experiments", "reference_filters", "sphfilter")):
            raise  # a mistake of ours
        need = f"error: the experiments need {problem.name}, which is not installed"
        raise SystemExit(f'{need}: pip install -e ".[experiments]"') from None
    return commands


if __name__ == "__main__":
    sys.exit(stoppable(_commands, main))
