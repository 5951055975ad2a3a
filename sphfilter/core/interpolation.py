"""Values of a table between its arguments; both stand in an array of parameters, the arguments first."""

from ._jit import jit


@jit
def linear(p, start, count, x):
    """Straight lines between the values of a table that stands in p from `start` on."""
    k = _place(p, start, count, x)
    value = p[start + count + k]
    if k + 1 == count or x <= p[start]:
        return value
    return value + slope(p, start, count, x) * (x - p[start + k])


@jit
def slope(p, start, count, x):
    """Slope of `linear`."""
    k = _place(p, start, count, x)
    if k + 1 == count or x < p[start]:
        return 0.0
    rise = p[start + count + k + 1] - p[start + count + k]
    return rise / (p[start + k + 1] - p[start + k])


@jit
def previous(p, start, count, x):
    """Values of a table, each held until the next."""
    return p[start + count + _place(p, start, count, x)]


@jit
def _place(p, start, count, x):
    """Number of the last argument that is not above x; zero before the first."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if p[start + middle] <= x:
            low = middle
        else:
            high = middle
    return low
