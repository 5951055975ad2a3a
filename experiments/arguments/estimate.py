"""What `estimate` takes."""

from pathlib import Path

from experiments.scene.files import add_change_option, changes_of
from experiments.scene.reading import read_settings
from experiments.terminal.options import counted, names_of
from sphfilter.errors import ConfigError

__all__ = ["EPILOG", "MEASURED", "SENSOR", "add_arguments", "check", "guesses"]

#: Name under which the variance of a sensor's noise is fitted, where it is one number on the diagonal.
SENSOR = "R"
#: Name that is no scenario: the measured numbers.
MEASURED = "sunspots"

EPILOG = f"""\
Measurements are simulated with the parameters of the scenario's file, 60 unless times.end is set, and the
search begins at three quarters of them. Parameters are those of the model and of its sensors, by name;
{SENSOR} is the variance of the sensor's noise, where no parameter is called so. NAME may be
sunspots: there the measurements are those of 1700 to 1948, and the search begins with the model's file.
"""


def add_arguments(parser):
    """Add the options of `estimate`."""
    parser.add_argument("scenario", metavar="NAME", help="a scenario with parameters, or sunspots")
    names = f"comma-separated; {SENSOR} is the sensor's noise"
    parser.add_argument("--parameters", metavar="NAMES", type=names_of, help=names)
    parser.add_argument("--guess", action="append", default=[], metavar="NAME=VALUE", help="where to begin")
    parser.add_argument("--n-particles", type=int, help="of the filter, at most (default: 400)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated measurements (default: 0)")
    parser.add_argument(
        "--jobs", type=counted, default=1, help="processes, for the profiles (default: %(default)s)"
    )
    parser.add_argument("--no-profile", action="store_true", help="no profiles, which take most of the time")
    parser.add_argument(
        "--compare",
        action="store_true",
        help="fit a rival model too (duffing; sunspots, where it takes half an hour and more)",
    )
    parser.add_argument("--out", type=Path, help="folder for results (default: results/estimate_NAME)")
    add_change_option(parser, "change a key of the scenario, e.g. times.end=100; may be repeated")


def guesses(texts):
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise ConfigError(f"a guess is NAME=VALUE, not {text!r}; for instance xi=0.3")
    return found


def check(args):
    """Raise what is wrong with scenario or guesses."""
    guesses(args.guess)
    if args.scenario != MEASURED:
        read_settings(args.scenario, changes_of(args))
