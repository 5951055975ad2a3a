"""The filters by name; to make them is up to `filters`."""

from sphfilter.errors import ConfigError, nearest

#: What the names stand for.
FILTERS = {
    "kf": "Kalman filter (exact for linear models)",
    "ekf": "extended Kalman filter",
    "ukf": "unscented Kalman filter",
    "pf": "bootstrap particle filter",
    "sph": "SPH filter: carries the density itself, default scheme",
    "sph_paper": "SPH filter with the published scheme",
    "grid": "density on a grid (1 or 2 states), the referee",
    "benes": "closed form of the Beneš problem",
}


def name_of(name):
    """A filter's name as a heading."""
    return name.upper().replace("_", " ")


def check_filters(names):
    """Raise `ConfigError` unless these are names of filters, and some; None stands for a scenario's own."""
    for name in names or ():
        if name not in FILTERS:
            raise ConfigError(f"no filter {name!r}{nearest(name, FILTERS)}; there are {', '.join(FILTERS)}")
    if names is not None and not names:
        raise ConfigError(f"no filter is asked for; there are {', '.join(FILTERS)}")
