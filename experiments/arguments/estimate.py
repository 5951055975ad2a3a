"""What `estimate` takes."""

from pathlib import Path

from experiments.scene.files import changes_of
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_changes, counted, names_of
from sphfilter.errors import ConfigError

#: Name under which the variance of a sensor's noise is fitted, where it is one number on the diagonal.
SENSOR = "R"
#: Name that is no scenario: the measured numbers.
MEASURED = "sunspots"


def add_arguments(add):
    """Add the options of `estimate`."""
    add("scenario", "a scenario with parameters, or sunspots", metavar="NAME")
    add("--parameters", f"comma-separated; {SENSOR} is the sensor's noise", names_of, metavar="NAMES")
    add("--guess", "where to begin", action="append", default=[], metavar="NAME=VALUE")
    add("--n-particles", "of the filter, at most", int, None, "400")
    add("--seed", "seed of the simulated measurements", int, 0)
    add("--jobs", "processes, for the profiles", counted, 1)
    add("--no-profile", "no profiles, which take most of the time", bool)
    rival = "fit a rival model too (duffing; sunspots, where it takes half an hour and more)"
    add("--compare", rival, bool)
    add("--out", "folder for results", Path, None, "results/estimate_NAME")
    add_changes(add, "change a key of the scenario, e.g. times.end=100; may be repeated")


def guesses(texts):
    """First values by name, of texts NAME=VALUE."""
    return dict(map(_guess, texts))


def _guess(text):
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise ConfigError(f"a guess is NAME=VALUE, not {text!r}; for instance xi=0.3") from None


def check(args):
    """Raise what is wrong with scenario or guesses."""
    guesses(args.guess)
    if args.scenario != MEASURED:
        read_settings(args.scenario, changes_of(args))
