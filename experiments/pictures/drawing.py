"""The pictures by name: which a scenario has, chosen, drawn and told.

Each picture is a function ``(scenario, seed, n_runs) -> Picture``: figures by file stem, and what they show
in words. `draw` writes the one and tells the other. The transient figures take model, start and parameters
from the scenario, and the noise from 002 Tables 1 to 3 (2Ξ), which is weaker than that of its filter tables.
"""

from sphfilter.errors import ConfigError, nearest

from ..show.style import save
from .accuracy import initial_accuracy, support_sweep
from .densities import transient_densities
from .rejections import rejected_measurements

__all__ = ["PICTURES", "chosen", "draw", "names"]

#: Pictures of a scenario, by name.
PICTURES = {
    "linear_underdamped": {"support": support_sweep, "accuracy": initial_accuracy},
    "van_der_pol": {"accuracy": initial_accuracy},
    "duffing": {"densities": transient_densities, "rejections": rejected_measurements},
}


def names(scenario):
    """Names of the pictures that a scenario has, a tuple; empty for scenarios that are not of 002."""
    return tuple(PICTURES.get(scenario.name, ()))


def chosen(scenario, text):
    """Names in a comma-separated text, checked; all of the scenario for None, none for "none".

    Raises
    ------
    ConfigError
        The scenario has no such picture.
    """
    known = names(scenario)
    if text is None or text.strip() == "none":
        return known if text is None else ()
    wanted = tuple(name.strip() for name in text.split(","))
    for name in wanted:
        _check(scenario, name)
    return wanted


def _check(scenario, name):
    known = names(scenario)
    if name not in known:
        listed = ", ".join(known) or "none"
        raise ConfigError(
            f"{scenario.name} has no picture {name!r}{nearest(name, known)}; its pictures: {listed}"
        )


def draw(name, scenario, folder, seed, n_runs=None, say=print):
    """Draw a picture of a scenario, of one or more files.

    Parameters
    ----------
    name : str
        One of `names`.
    scenario : Scenario
    folder : Path
    seed : int
        Of the runs, for pictures that simulate some; the same runs as in the campaign.
    n_runs : int, optional
        Runs of such pictures; the scenario's own number by default.
    say : callable
        Called with each sentence about the picture.

    Returns
    -------
    list of Path

    Raises
    ------
    ConfigError
        The scenario has no such picture.
    """
    _check(scenario, name)
    picture = PICTURES[scenario.name][name](scenario, seed, n_runs or scenario.settings.runs.default)
    for sentence in picture.sentences:
        say(sentence)
    return [save(figure, folder / f"{stem}.png") for stem, figure in picture.figures.items()]
