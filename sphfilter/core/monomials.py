"""Monomials x^a = x1^a1 ... xn^an by their powers."""

from itertools import product


def up_to(order, dim):
    """All powers of `dim` variables of total order 0 to `order`, lowest order first, as tuples."""
    every = (a for a in product(range(order + 1), repeat=dim) if sum(a) <= order)
    return sorted(every, key=lambda a: (sum(a), tuple(-k for k in a)))
