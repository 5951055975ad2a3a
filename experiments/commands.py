"""The commands, and the command line that they make."""

import argparse
import sys

from sphfilter.errors import SphfilterError

from . import guide, listing, realtime, run, scaling
from .benchmark import command as benchmark
from .campaign import command as campaign
from .converge import command as converge
from .estimate import command as estimate
from .own_data import command as own_data
from .skips import command as skips
from .stress import command as stress
from .sunspots import command as sunspots
from .sweep import command as sweep
from .transient import command as transient

__all__ = ["COMMANDS", "main"]

#: Modules with a one-line docstring, ``add_arguments(parser)`` and ``main(args)``, which returns an exit code
#: or None; ``EPILOG`` ends their help, if they have one.
COMMANDS = {
    "list": listing,
    "run": run,
    "campaign": campaign,
    "transient": transient,
    "sweep": sweep,
    "converge": converge,
    "estimate": estimate,
    "filter": own_data,
    "benchmark": benchmark,
    "stress": stress,
    "skips": skips,
    "scaling": scaling,
    "realtime": realtime,
}
#: Names that `run` takes and that are no scenarios: measured data, with options of their own.
MEASURED = {"sunspots": sunspots}


def parser():
    """The command line."""
    summaries = {name: _summary(module) for name, module in COMMANDS.items()}
    top = argparse.ArgumentParser(
        prog="python -m experiments",
        usage="python -m experiments COMMAND [options]",
        description="Experiments with the filters. COMMAND --help tells more of each.",
        epilog=guide.overview(summaries),
        formatter_class=argparse.RawDescriptionHelpFormatter,  # examples keep their lines
    )
    commands = top.add_subparsers(
        dest="command", required=True, metavar="COMMAND", help=argparse.SUPPRESS, prog="python -m experiments"
    )
    for name, module in COMMANDS.items():
        _filled(commands.add_parser(name, description=summaries[name], epilog=_epilog(name, module)), module)
    return top


def _filled(parser, module):
    """A command's parser with the options of its module."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    module.add_arguments(parser)
    parser.set_defaults(main=module.main)
    return parser


def _epilog(name, module):
    return "\n\n".join(filter(None, [guide.examples(name), getattr(module, "EPILOG", "")])) or None


def _measured_parser(name):
    """The command line of `run` with a name of `MEASURED`."""
    module, prog = MEASURED[name], f"python -m experiments run {name}"
    example = f"Example:\n  {prog} --out results/{name}"
    return _filled(argparse.ArgumentParser(prog, description=_summary(module), epilog=example), module)


def _summary(module):
    return module.__doc__.partition("`: ")[2].splitlines()[0]


def main(argv=None):
    """Run a command and return its exit code: 0, 1 after an error, 130 after an interruption.

    A command that tells of a filter that failed, and goes on with the others, ends with 1 too.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    measured = argv[:1] == ["run"] and len(argv) > 1 and argv[1] in MEASURED
    args = _measured_parser(argv[1]).parse_args(argv[2:]) if measured else parser().parse_args(argv)
    try:
        return args.main(args) or 0
    except SphfilterError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(str(stop) or "Stopped.", file=sys.stderr)
        return 130
