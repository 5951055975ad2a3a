"""The command line: ``python -m experiments list``, ``run NAME``, ``sweep NAME``."""

import argparse
import sys

from sphfilter.errors import SphfilterError

from . import listing, run, sweep

#: Modules with a one-line docstring, ``add_arguments(parser)`` and ``main(args)``.
COMMANDS = {"list": listing, "run": run, "sweep": sweep}


def parser():
    """The command line."""
    top = argparse.ArgumentParser(prog="python -m experiments", description="Experiments with the filters.")
    commands = top.add_subparsers(dest="command", required=True)
    for name, module in COMMANDS.items():
        summary = module.__doc__.partition("`: ")[2].splitlines()[0]
        command = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(command)
        command.set_defaults(main=module.main)
    return top


def main(argv=None):
    """Run a command and return its exit code: 0, 1 after an error, 130 after an interruption."""
    args = parser().parse_args(argv)
    try:
        args.main(args)
    except SphfilterError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(str(stop) or "stopped", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
