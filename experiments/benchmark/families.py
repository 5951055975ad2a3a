"""The families of competitors by name; their filters and sizes are in `methods`."""

from sphfilter.errors import ConfigError, nearest

#: What the names stand for, short and in words. Any scheme of the SPH filter can be forced with sph:SCHEME.
FAMILIES = {
    "sph": ("SPH", "SPH filter, default"),
    "auto": ("SPH, auto", "SPH filter, particles by target error"),
    "paper": ("SPH, paper", "SPH filter, scheme of the paper"),
    "ekf": ("EKF", "extended Kalman filter"),
    "ukf": ("UKF", "unscented Kalman filter"),
    "kf": ("KF", "Kalman filter (linear models)"),
    "pf": ("PF, order 2", "particle filter, weak order 2"),
    "pf4": ("PF, order 4", "particle filter, weak order 4"),
    "grid": ("Grid, boxed", "grid filter in a box it is told"),
    "referee": ("Grid, free", "grid filter that finds its box"),
    "benes": ("Beneš", "closed form of the Beneš problem"),
}


def check_families(names):
    """Raise `ConfigError` unless these are names of families; the nearest name is told."""
    for name in names:
        if name not in FAMILIES and not name.startswith("sph:"):
            known = [*FAMILIES, "sph:SCHEME"]
            raise ConfigError(f"no competitor {name!r}{nearest(name, known)}; there are {', '.join(known)}")
