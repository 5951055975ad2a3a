"""The pictures of the paper by name: which a scenario has, and where each is made."""

from sphfilter.errors import ConfigError, nearest

__all__ = ["PICTURES", "chosen", "names", "place_of"]

#: Pictures of a scenario, by name: module of this room, and function.
PICTURES = {
    "linear_underdamped": {
        "support": ("accuracy", "support_sweep"),
        "accuracy": ("accuracy", "initial_accuracy"),
    },
    "van_der_pol": {"accuracy": ("accuracy", "initial_accuracy")},
    "duffing": {
        "densities": ("densities", "transient_densities"),
        "rejections": ("rejections", "rejected_measurements"),
    },
}
#: Those that repeat a scenario's runs in other settings: drawn where they are asked for.
_STUDIES = frozenset({"rejections"})


def names(scenario):
    """Names of the pictures that a scenario has, a tuple; empty for scenarios that are not of 002.

    Parameters
    ----------
    scenario : str
    """
    return tuple(PICTURES.get(scenario, ()))


def chosen(scenario, text):
    """Names in a comma-separated text, checked; for None all of the scenario but studies, none for "none".

    Raises
    ------
    ConfigError
        The scenario has no such picture.
    """
    known = names(scenario)
    if text is None:
        return tuple(name for name in known if name not in _STUDIES)
    if text.strip() == "none":
        return ()
    wanted = tuple(name.strip() for name in text.split(","))
    for name in wanted:
        place_of(scenario, name)
    return wanted


def place_of(scenario, name):
    """Module and function of a picture of a scenario.

    Raises
    ------
    ConfigError
        The scenario has no such picture.
    """
    known = names(scenario)
    if name not in known:
        listed = ", ".join(known) or "none"
        raise ConfigError(f"{scenario} has no picture {name!r}{nearest(name, known)}; its pictures: {listed}")
    return PICTURES[scenario][name]
