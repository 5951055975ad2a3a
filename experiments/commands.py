"""The commands, and the command line that they make."""

import argparse
import ast
import re
import sys
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from tempfile import NamedTemporaryFile

from . import guide

#: Modules with a one-line docstring and ``main(args)``, which returns an exit code or None. They are imported
#: when the command line has been checked: what is wrong with it is answered at once. That is up to the module
#: of the command's name in `arguments`, which has ``add_arguments(add)`` and, where something may be wrong,
#: ``check(args)``, which raises it. A text of that name beside it is the end of the command's help.
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


def module(name):
    """The module of a command."""
    return import_module(f"{__package__}.{COMMANDS[name]}")


def arguments(name):
    """The module of a command's arguments."""
    return import_module(f"{__package__}.arguments.{name}")


class Refused(Exception):
    """A command line that cannot be carried out; the message says why."""


def load(argv):
    """Import what a command line asks for, unless it is refused, which `main` tells."""
    with suppress(Refused):
        name = asked(argv)[0]
        with _told("loading"):
            module(name)


@contextmanager
def _told(text):
    """Show a text at a terminal until the block ends."""
    if sys.stderr.isatty():
        print(text, "...", end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def asked(argv):
    """Name of the command, and its arguments, checked; raises `Refused`."""
    with unopened("sphfilter"):
        from sphfilter.errors import SphfilterError

        argv = argv or ["--help"]
        name, args = argv[0], parser(argv).parse_args(argv)
        try:
            getattr(arguments(name), "check", lambda args: None)(args)
            if "out" in args:
                check_folder(args.out or Path("results"))
        except SphfilterError as problem:
            raise Refused(str(problem)) from None
    return name, args


@contextmanager
def unopened(package):
    """Let modules of a package be imported without what the package itself imports, until the block ends.

    Settings and errors of the library take a tenth of the time that all of it takes.
    """
    if package in sys.modules:
        yield
        return
    spec = find_spec(package)
    opened = sys.modules[package] = module_from_spec(spec)
    try:
        yield
        spec.loader.exec_module(opened)
    except BaseException:
        del sys.modules[package]
        raise


def check_folder(folder):
    """Raise `ConfigError` if a folder cannot be made, or not be written to; nothing of it stays."""
    from sphfilter.errors import ConfigError

    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(dir=folder):
            pass
    except OSError as problem:
        raise ConfigError(
            f"results cannot be written to {folder} ({problem.strerror}); give another folder with --out"
        ) from None
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def parser(argv):
    """The command line, with the options of the command that argv begins with."""
    summaries = {name: _summary(name) for name in COMMANDS}
    top = _Parser(
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
            own.epilog = guide.end_of_help(name)
            top.of_command = _filled(own, name)
    return top


def _filled(parser, name):
    """A command's parser with its options."""
    from .terminal.options import adder  # which reads scenarios

    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    arguments(name).add_arguments(adder(parser))
    return parser


class _Parser(argparse.ArgumentParser):
    """Answers a mistake in one sentence, not in a page of options."""

    of_command: argparse.ArgumentParser | None = None  # that is asked for

    def error(self, message):
        """Print it, with what may have been meant, and end the program."""
        from sphfilter.errors import nearest

        given = re.match(
            r"argument COMMAND: invalid choice: '([^']*)'|unrecognized arguments: (--[^\s=]+)", message
        )
        if given:
            command, option = given.groups()
            options = re.findall(r"--[a-z][-a-z]+", (self.of_command or self).format_help())
            message += nearest(option, options) if option else nearest(command, COMMANDS)
        self.exit(2, f"error: {message} ({self.prog} --help tells more)\n")


def _summary(name):
    """What the docstring of a command's module begins with, read without importing the module."""
    source = find_spec(f"{__package__}.{COMMANDS[name]}").loader.get_source(None)
    return ast.get_docstring(ast.parse(source)).partition("`: ")[2].splitlines()[0]


def main(argv=None):
    """Run a command and return its exit code: 0, 1 after an error, 130 after an interruption.

    A command that tells of a filter that failed, and goes on with the others, ends with 1 too.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    try:
        name, args = asked(argv)
    except Refused as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    from sphfilter.errors import SphfilterError

    try:
        return module(name).main(args) or 0
    except SphfilterError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(str(stop) or "Stopped.", file=sys.stderr)
        return 130
