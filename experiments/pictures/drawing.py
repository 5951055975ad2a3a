"""A picture of the paper, drawn and told.

Each picture is a function ``(scenario, seed, n_runs, known) -> Picture``: figures by file stem, and what they
show in words; `known` is what a campaign has computed already. The transient figures take model, start and
parameters from the scenario, and the noise from 002 Tables 1 to 3 (2Ξ), which is weaker than that of its
filter tables.
"""

from importlib import import_module

from sphfilter.campaign.campaign import CampaignResult

from ..show.style import save
from .names import place_of

__all__ = ["OF_RUNS", "draw"]

#: Pictures that use the runs of a campaign, if there are any.
OF_RUNS = frozenset({"rejections"})


def draw(name, scenario, folder, seed, n_runs=None, campaign=None):
    """Draw a picture of a scenario, of one or more files.

    Parameters
    ----------
    name : str
        One of `names.names`.
    scenario : Scenario
    folder : Path
    seed : int
        Of the runs, for pictures that simulate some; the same runs as in the campaign.
    n_runs : int, optional
        Runs of such pictures; the scenario's own number by default.
    campaign : Path, optional
        File of a campaign of these runs: what the scenario's own filters made of them is not computed again.

    Returns
    -------
    paths : list of Path
    sentences : tuple of str
        About the picture.

    Raises
    ------
    ConfigError
        The scenario has no such picture.
    """
    module, function = place_of(scenario.name, name)
    make = getattr(import_module(f".{module}", __package__), function)
    known = {} if campaign is None else CampaignResult.load(campaign).results
    picture = make(scenario, seed, n_runs or scenario.settings.runs.default, known)
    return [save(figure, folder / f"{k}.png") for k, figure in picture.figures.items()], picture.sentences
