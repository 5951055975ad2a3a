"""Random models of one to four states, as text: stable drifts of many kinds, noise of random rank."""

import numpy as np

from .equations import Equation, weighted


def random_equation(rng, n, horizon, interval):
    """Draw a model of n states; its drift in words, and the `Equation`.

    It will be followed for `horizon` seconds and read after every `interval`.
    """
    states = tuple(f"x{i}" for i in range(n))
    linear = rng.random() < 0.2
    if linear:
        kind, drift = "linear", _linear(rng, states)
    else:
        kind, drift = _blocks(rng, states)
    noise = _noise(rng, states, [f == "0" for f in drift], linear)
    drift, noise, *clock = _with_clock(rng, drift, noise, horizon, interval)
    matrix = linear and np.isinf(clock[0]) and rng.random() < 0.5
    return kind, Equation(states=states, drift=tuple(drift), noise=noise, matrix=matrix,
                          shortest=clock[0], busy=clock[1])  # fmt: skip


def _number(rng, low, high):
    """A number of three digits between two bounds, all orders of magnitude alike."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _linear(rng, states):
    """Decays and turns, in a random basis."""
    n = len(states)
    rates = -np.array([_number(rng, 0.05, 20.0 if rng.random() < 0.3 else 3.0) for _ in range(n)])
    A = np.diag(rates)
    if n > 1 and rng.random() < 0.6:
        turn = _number(rng, 0.3, 5.0)
        A[0, 1], A[1, 0], A[1, 1] = turn, -turn, A[0, 0]
    basis = np.eye(n) + 0.4 * rng.standard_normal((n, n))
    if abs(np.linalg.det(basis)) > 0.1:
        A = basis @ A @ np.linalg.inv(basis)
    return [weighted(np.round(row, 4), states) for row in A]


#: Drifts of one state in words, and as text of its name x and of numbers a (a rate) and k.
_ONE = {
    "linear": "-{a}*{x}",
    "stiff": "-{r}*{x}",
    "cubic": "-{a}*{x}**3 + {k}*{x}",
    "quintic": "-{b}*{x}**5 - {a}*{x}",
    "double well": "{a}*({x} - {x}**3)",
    "wide wells": "{a}*{x} - {b}*{x}**3",
    "sine": "{k}*sin({x}) - {b}*{x}",
    "waves": "{a}*sin({w}*{x}) - {a}*{x}",
    "tanh": "-{a}*tanh({w}*{x})",
    "root": "-{a}*{x}/sqrt(1 + {x}**2)",
    "static": "0",
    "random walk": "0.0*{x}",
}
#: The same of two states x and v.
_TWO = {
    "Van der Pol": ("{v}", "{k}*(1 - {x}**2)*{v} - {x}"),
    "Duffing": ("{v}", "{x} - {b}*{x}**3 - {a}*{v}"),
    "pendulum": ("{v}", "-{w}*sin({x}) - {b}*{v}"),
    "oscillator": ("{v}", "-{w}*{x} - {b}*{v}"),
    "neuron": ("{x} - {x}**3/3 - {v} + 0.5", "{b}*({x} + 0.7 - 0.8*{v})"),
    "prey": ("{b}*{x} - {x}**3 - {v}", "{x} - {a}*{v}"),
}


def _blocks(rng, states):
    """One or two states at a time of each kind, pushed weakly by their neighbours."""
    names, drift, left = [], [], list(states)
    while left:
        kinds = _TWO if len(left) > 1 and rng.random() < 0.5 else _ONE
        name = str(rng.choice(list(kinds)))
        texts = kinds[name] if kinds is _TWO else (kinds[name],)
        x, v = left[0], left[1] if kinds is _TWO else ""
        numbers = {
            "a": _number(rng, 0.2, 3.0),
            "b": _number(rng, 0.05, 0.6),
            "k": _number(rng, 0.3, 2.0),
            "w": _number(rng, 0.5, 4.0),
            "r": _number(rng, 5.0, 60.0),
        }
        drift += [text.format(x=x, v=v, **numbers) for text in texts]
        names, left = [*names, name], left[len(texts) :]
    for i, f in enumerate(drift):
        if f != "0" and len(states) > 1 and rng.random() < 0.5:
            other = rng.choice([s for s in states if s != states[i]])
            push = str(rng.choice(["{c}*sin({y})", "{c}*tanh({y})", "{c}*{y}/(1 + {y}**2)"]))
            drift[i] = f"{f} + {push.format(c=_number(rng, 0.1, 1.0), y=other)}"
    return ", ".join(names), drift


#: Factors of a noise that depends on the state y.
_STATE = ("sqrt(1 + 0.5*{y}**2)", "(1 + 0.5*sin({y}))", "(1 + 0.6*tanh({y}))", "1/(1 + 0.5*{y}**2)")


def _noise(rng, states, static, linear):
    """Rows of texts: as many independent noises as a random rank, none on static states."""
    n = len(states)
    m = int(rng.integers(0 if rng.random() < 0.15 else 1, n + 1))
    size = np.array([_number(rng, 0.05, 1.5) for _ in range(m)])
    G = (np.eye(n)[:, rng.permutation(n)[:m]] if rng.random() < 0.5 else rng.standard_normal((n, m))) * size
    G[static] = 0.0
    G = G[:, np.any(G != 0.0, axis=0)]
    texts = [[f"{g:.4g}" for g in row] for row in G]
    if not linear and rng.random() < 0.22:
        factor = str(rng.choice(_STATE)).format(y=str(rng.choice(states)))
        texts = [[g if float(g) == 0.0 else f"{g}*{factor}" for g in row] for row in texts]
    return tuple(map(tuple, texts))


def _with_clock(rng, drift, noise, horizon, interval):
    """Let drift or noise depend on time for some, smoothly: a wave, or a pulse between two readings."""
    busy = -np.inf, np.inf
    moving = [i for i, f in enumerate(drift) if f != "0"]
    if rng.random() > 0.25 or not (moving or noise[0]):
        return drift, noise, np.inf, busy
    if rng.random() < 0.5:
        omega = _number(rng, 0.5, 20.0) / interval
        shape, shortest = f"sin({omega:.4g}*t)", 1.0 / omega
    else:
        shortest = interval * _number(rng, 0.02, 0.3)
        centre = rng.uniform(0.1, 0.9) * horizon
        shape = f"exp(-((t - {centre:.4g})/{shortest:.4g})**2)"
        busy = centre - 5.0 * shortest, centre + 5.0 * shortest
    if moving and (rng.random() < 0.5 or not noise[0]):
        i = int(rng.choice(moving))
        push = _number(rng, 0.2, 2.0) / min(1.0, 3.0 * shortest)
        drift = [f"{f} + {push:.3g}*{shape}" if i == j else f for j, f in enumerate(drift)]
    else:
        factor = f"sqrt(1 + {_number(rng, 0.5, 20.0)}*({shape})**2)"
        noise = tuple(tuple(g if g == "0" else f"{g}*{factor}" for g in row) for row in noise)
    return drift, noise, shortest, busy
