"""The commands, and the command line that they make."""

import argparse
import ast
import sys
from importlib import import_module
from importlib.util import find_spec

from . import guide

__all__ = ["COMMANDS", "load", "main", "module", "parser"]

#: Modules with a one-line docstring, ``add_arguments(parser)`` and ``main(args)``, which returns an exit code
#: or None; ``EPILOG`` ends their help, if they have one. They are imported when they are asked for: a wrong
#: word on the command line is answered at once.
COMMANDS = {
    "list": "listing",
    "run": "run",
    "campaign": "campaign.command",
    "transient": "transient.command",
    "sweep": "sweep.command",
    "converge": "converge.command",
    "estimate": "estimate.command",
    "filter": "own_data.command",
    "benchmark": "benchmark.command",
    "stress": "stress.command",
    "skips": "skips.command",
    "scaling": "scaling",
    "realtime": "realtime",
    "switching": "switching.command",
}
#: Names that `run` takes and that are no scenarios: measured data, with options of their own.
MEASURED = {"sunspots": "sunspots.command"}


def module(name):
    """The module of a command, or of measured data."""
    return import_module(f"{__package__}.{(COMMANDS | MEASURED)[name]}")


def load(argv):
    """Import what a command line asks for."""
    if argv and argv[0] in COMMANDS:
        module(argv[1] if _is_measured(argv) else argv[0])


def _is_measured(argv):
    return argv[:1] == ["run"] and len(argv) > 1 and argv[1] in MEASURED


def parser(argv):
    """The command line, with the options of the command that argv begins with."""
    summaries = {name: _summary(name) for name in COMMANDS}
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
    for name in COMMANDS:
        own = commands.add_parser(name, description=summaries[name])
        if argv[:1] == [name]:
            own.epilog = _epilog(name, module(name))
            _filled(own, module(name))
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
    prog = f"python -m experiments run {name}"
    example = f"Example:\n  {prog} --out results/{name}"
    return _filled(argparse.ArgumentParser(prog, description=_summary(name), epilog=example), module(name))


def _summary(name):
    """What the docstring of a command's module begins with, read without importing the module."""
    source = find_spec(f"{__package__}.{(COMMANDS | MEASURED)[name]}").loader.get_source(None)
    return ast.get_docstring(ast.parse(source)).partition("`: ")[2].splitlines()[0]


def main(argv=None):
    """Run a command and return its exit code: 0, 1 after an error, 130 after an interruption.

    A command that tells of a filter that failed, and goes on with the others, ends with 1 too.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    measured = _is_measured(argv)
    args = _measured_parser(argv[1]).parse_args(argv[2:]) if measured else parser(argv).parse_args(argv)
    from sphfilter.errors import SphfilterError  # its command has imported the library by now

    try:
        return args.main(args) or 0
    except SphfilterError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(str(stop) or "Stopped.", file=sys.stderr)
        return 130
