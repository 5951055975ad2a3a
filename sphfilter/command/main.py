"""The command line of ``sphfilter``."""

import argparse
import sys
from collections.abc import Sequence

from .._version import __version__
from ..errors import SphfilterError
from . import comparing, doctor, filtering, fitting, forecasting, simulating
from .interruption import Exit, stoppable
from .progress import told

_VERBS = {
    "filter": (filtering, "estimate the states, line by line of a CSV file"),
    "fit": (fitting, "find parameters by maximum evidence"),
    "compare": (comparing, "compare models by the evidence of the same data"),
    "forecast": (forecasting, "filter, and forecast times to come with quantiles"),
    "simulate": (simulating, "draw readings of a model, for trying it out"),
    "doctor": (doctor, "look at the installation: versions, compiled code, a small filter"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command of ``sphfilter`` and return its exit code: 0, 2 if it is refused, 130 after Ctrl-C.

    Examples
    --------
    >>> from sphfilter.command.main import main
    >>> main(["filter", "--model", "none.toml", "--data", "none.csv"])
    2
    """
    if argv is None:  # a program, which the terminal may stop anywhere
        return stoppable(lambda: None, lambda: _run(sys.argv[1:]))
    return _run(argv)


def _run(argv: Sequence[str]) -> int:
    args = _parser().parse_args(argv)
    try:
        with told() as say:
            say(f"sphfilter {args.command}")  # reading texts takes a second
            found = _VERBS[args.command][0].main(args, say)
    except SphfilterError as problem:
        return _ended(str(problem), Exit.REFUSED)
    except KeyboardInterrupt as stop:
        return _ended(str(stop) or "stopped", Exit.STOPPED)
    except OSError as problem:
        return _ended(f"cannot write {problem.filename}: {problem.strerror}", Exit.REFUSED)
    print(found)
    return 0


def _ended(sentence: str, code: int) -> int:
    print(f"sphfilter: {sentence}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        prog="sphfilter",
        description="Bayes filters from files: a model as TOML, measurements as CSV.",
        epilog="sphfilter filter --help shows both files.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (verb, summary) in _VERBS.items():
        own = verbs.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        verb.add_arguments(own)
    return top
