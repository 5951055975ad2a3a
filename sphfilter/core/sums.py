"""Sums in an order of their own, eight at a time: vector code, and the same bits wherever it is compiled."""

from ._jit import jit


@jit
def summed(v):
    """The sum of numbers (N,)."""
    a = b = c = d = e = f = g = h = 0.0
    eights = v.size // 8
    for k in range(eights):
        i = 8 * k
        a, b, c, d = a + v[i], b + v[i + 1], c + v[i + 2], d + v[i + 3]
        e, f, g, h = e + v[i + 4], f + v[i + 5], g + v[i + 6], h + v[i + 7]
    for i in range(8 * eights, v.size):
        a += v[i]
    return ((a + b) + (c + d)) + ((e + f) + (g + h))


@jit
def dot(u, v):
    """The sum of the products of numbers u and v (N,)."""
    a = b = c = d = e = f = g = h = 0.0
    eights = u.size // 8
    for k in range(eights):
        i = 8 * k
        a, b, c = a + u[i] * v[i], b + u[i + 1] * v[i + 1], c + u[i + 2] * v[i + 2]
        d, e, f = d + u[i + 3] * v[i + 3], e + u[i + 4] * v[i + 4], f + u[i + 5] * v[i + 5]
        g, h = g + u[i + 6] * v[i + 6], h + u[i + 7] * v[i + 7]
    for i in range(8 * eights, u.size):
        a += u[i] * v[i]
    return ((a + b) + (c + d)) + ((e + f) + (g + h))
