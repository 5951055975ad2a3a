"""Ways to make every failure of `sphfilter/FAILURES.md` happen: what the library and commands say then."""

from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
from scipy import stats

import sphfilter as sf
from sphfilter.errors import UnresolvedError
from sphfilter.filter import sph_filter

UNIT, ROUND = sf.Gaussian([0.0], [[1.0]]), sf.Gaussian([0.0, 0.0], np.eye(2))
POSITION = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
HEIGHT = sf.GaussianMeasurement([[1.0]], [[0.1]])
SQUARE = sf.GaussianMeasurement(lambda x: (x[0] ** 2,), [[0.01]])
RING = sf.GaussianMeasurement(lambda x: (x[0] ** 2 + x[1] ** 2,), [[1e-6]])
ROOT = sf.GaussianMeasurement(lambda x: (np.sqrt(x[0]),), [[0.01]])
START = [3.0, 0.0], np.diag([0.2, 1.0])


def line(drift, noise="1", **options):
    """dx = drift dt + noise dW."""
    return sf.SDE.from_expressions(["x"], [drift], [[noise]], **options)


def wells():
    drift = ["v", "-0.4*v - x*(-1 + 0.1*x**2)"]
    return sf.SDE.from_expressions(["x", "v"], drift, [["0"], ["1"]], [[1.6]])


def laid(distribution=UNIT, n_particles=60, scheme="auto", **options):
    return sf.initialize(distribution, n_particles, sf.SolverConfig(scheme=scheme), **options)


def predicted(model, dt=1.0, scheme="auto", start=UNIT, **options):
    """The status of a prediction."""
    density = laid(start, scheme=scheme, **options)
    return sf.predict(density, model, dt, sf.SolverConfig(scheme=scheme))[1].status


def updated(sensor, z, **options):
    """The reason of an update of a normal density."""
    return sf.update(laid(), sensor, z, sf.FilterConfig(**options))[1].reason


def filtering(n_particles=150, **options):
    return sf.SPHFilter(wells(), POSITION, *START, n_particles=n_particles, config=sf.FilterConfig(**options))


def late(at):
    """A reading that is of no step that a filter keeps."""
    return sf.SPHFilter(line("-x"), HEIGHT, [0.0], [[1.0]], window=1).update_late(0.0, at)


def unmet():
    """The status of an update whose target no lattice meets."""
    flt = sf.SPHFilter(line("-x - x**3"), HEIGHT, [0.3], [[0.5]], n_particles="auto",
                       config=sf.FilterConfig(target_error=1e-12))  # fmt: skip
    flt.predict(0.5)
    return flt.update([0.3]).status


def surprised(deviations=5.5, **options):
    """Status and reason of an update far out in the tail of a prediction."""
    flt = filtering(**options)
    flt.predict(2.0)
    info = flt.update(flt.x[:1] + deviations * np.sqrt(flt.P[0, 0]))
    return f"{info.status}; {info.reason}"


def lost():
    """A prediction after an update whose posterior is said to be too coarse for it."""
    flt, predict = filtering(), sf.predict
    flt.predict(0.5)
    flt.update([3.0])
    coarse = flt.density

    def picky(density, *args, **options):
        if density is coarse:
            raise UnresolvedError("too coarse")
        return predict(density, *args, **options)

    with patch.object(sph_filter, "predict", picky):
        return flt.predict(0.5).status


def silent(x, t):
    x[0] + t


def beyond(x, t):
    return (x[1],)


def unknown(x, t):
    return np.linalg.no_such_function(x)


WALLS = [("bounded", -6.0, 6.0)]
FLAT = sf.SDE.from_expressions(["x", "y"], ["-40*x", "-y"], [["0"], ["1"]])
STEEP = sf.LogDensityScheme(max_steps=1)
TESTED = {"acceptance": sf.AcceptanceTest(enabled=True)}
#: A spike on ground that is almost nothing, but far wider.
SPIKE = sf.LikelihoodMeasurement(
    lambda z, X, t: np.logaddexp(-0.5 * ((X[:, 0] - z[0]) / 0.003) ** 2, np.log(1e-6))
)
NOWHERE = sf.LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf))
NEGATIVE = sf.LikelihoodMeasurement(lambda z, X, t: np.where(X[:, 0] > 0, 0.0, np.nan))


def fitted(log_evidence, *names, times=(1.0,), z=((0.0,),)):
    """A fit of a filter that has nothing but a log-evidence."""

    class Filter:
        def __init__(self, p):
            self.value = log_evidence(**p)

        def run(self, times, z):
            return SimpleNamespace(log_evidence=np.array([self.value]), accepted=np.array([True]))

    return sf.fit_parameters(Filter, times, z, dict.fromkeys(names, 0.01))


def refused(*arguments, **named):
    raise sf.ModelError("no such filter")


NOISE = np.random.default_rng(1)
SAID_OF_FITS = [
    lambda: fitted(lambda a, b: -(a**2), "a", "b"),
    lambda: fitted(lambda a, b: -((a + b) ** 2) - 1e-9 * (a - b) ** 2, "a", "b"),
    lambda: fitted(lambda a, b: -(a**2) - 0.05 * b**2 + 0.5 * NOISE.standard_normal(), "a", "b"),
    lambda: fitted(lambda a, b: -100 * (a**2 + b**2) if a + b < 0.06 else -np.inf, "a", "b"),
    lambda: fitted(refused, "a"),
    lambda: sf.compare_models({"a": fitted(lambda a: -(a**2), "a")}, [2.0], [[0.0]]),
    lambda: sf.compare_models({"a": filtering()}),
    lambda: fitted(lambda ab: -(ab**2), "ab").posterior({"abc": stats.norm()}),
    lambda: fitted(lambda a: -(a**2), "a").posterior({"a": 1.0}),
    lambda: fitted(lambda a: -(a**2), "a").posterior(lambda p: -np.inf),
    lambda: sf.smooth(filtering(scheme="paper"), [1.0], [[0.1]]),
    lambda: sf.smooth(sf.SPHFilter(line("-x", domain=WALLS), HEIGHT, [0.0], [[1.0]]), [1.0], [[0.1]]),
]


def switched(velocity, noise, rate, z):
    """What is said of a model of a mode at rest and one that moves, and of a reading between the two."""
    modes = {name: sf.LinearSDE([[0.0]], [v], noise=[[noise]]) for name, v in (("a", 0.0), ("b", velocity))}
    model, fine = sf.JumpMarkovModel(modes, [[-rate, rate], [rate, -rate]]), [[4e-4]]
    start = {"x0": [0.0], "P0": [[0.01]], "mode_probabilities": {"a": 1.0}}
    flt = sf.JumpMarkovFilter(model, sf.GaussianMeasurement([[1.0]], fine), **start)
    return flt.predict(1.0).status + flt.update(z).status


SAID = [
    *SAID_OF_FITS,
    lambda: predicted(line("x**3")),
    lambda: predicted(line("x**3", "0.3"), scheme="cloud", start=sf.Gaussian([0.0], [[0.08]])),
    lambda: predicted(line("-x - x**3"), scheme=sf.CloudScheme(max_steps=2)),
    lambda: predicted(line("sqrt(x + 3)"), scheme="log_density"),
    lambda: predicted(line("-6*sign(x)", "0.1"), scheme="log_density"),
    lambda: sf.predict(laid(ROUND), wells(), 1.0, sf.SolverConfig(scheme="log_density"), n_particles=6),
    lambda: predicted(line("-x - x**3"), 400.0, STEEP),
    lambda: predicted(line("-x"), scheme=sf.PaperScheme(max_steps=1)),
    lambda: predicted(line("4*x", domain=WALLS), 2.0, "paper", domain=WALLS),
    lambda: predicted(line("-x"), -1.0),
    lambda: sf.update(sf.initialize(UNIT, "auto").noted(error=20.0), HEIGHT, [0.3])[1].status,
    lambda: predicted(line("4*sin(3*x)", "0.5"), 3.0, "family"),
    lambda: predicted(line("-x", domain=WALLS), scheme="family", domain=WALLS),
    lambda: sf.predict(laid(ROUND), wells(), 1.0, sf.SolverConfig(scheme=sf.FamilyScheme(degree=8))),
    lambda: updated(SQUARE, [4.0], scheme="family"),
    lambda: sf.predict(laid(), line("-x"), 1.0, n_particles="many"),
    unmet,
    lambda: predicted(wells()),
    lambda: filtering().predict(),
    lambda: sf.simulate(line("x**3"), None, [2.0], [0.0, 5.0], rng=1),
    lambda: filtering(40).predict(2.0).status,
    lambda: predicted(line("-x", domain=WALLS), domain=WALLS),
    lost,
    lambda: sf.update(laid(), SPIKE, [0.5])[1].status,
    lambda: updated(HEIGHT, None),
    lambda: updated(HEIGHT, [9.0]),
    lambda: sf.update(laid(ROUND), RING, [2.0])[1].status,
    lambda: updated(HEIGHT, [300.0]),
    lambda: updated(HEIGHT, [120.0]),
    lambda: updated(HEIGHT, [9.0], **TESTED),
    lambda: updated(SQUARE, [1.0], **TESTED),
    lambda: surprised(),
    lambda: updated(NOWHERE, [1.0]),
    lambda: updated(ROOT, [1.0]),
    lambda: updated(NEGATIVE, [1.0]),
    lambda: updated(HEIGHT, [1.0, 2.0]),
    lambda: updated(HEIGHT, [np.inf]),
    lambda: sf.SPHFilter(wells(), POSITION, [3.0], np.eye(2)),
    lambda: sf.SPHFilter(wells(), POSITION, [3.0, 0.0], [1.0, 1.0]),
    lambda: sf.GaussianMeasurement([[1.0]], [[-1.0]]),
    lambda: sf.GaussianMeasurement([[1.0]], [[1.0, 0.2], [0.1, 1.0]]),
    lambda: sf.GaussianMeasurement([[1.0]], [[np.nan]]),
    lambda: sf.SPHFilter(wells(), POSITION, [3.0, 0.0], np.diag([0.2, 0.0])),
    lambda: laid(sf.Gaussian(np.zeros(13), np.eye(13)), "auto"),
    lambda: laid(ROUND, 4),
    lambda: sf.SDE(unknown, 1, [[1.0]]),
    lambda: sf.SDE(type("Bound", (), {"drift": lambda self, x, t: (-x[0],)})().drift, 1, [[1.0]]),
    lambda: sf.SDE(silent, 1, [[1.0]]),
    lambda: sf.SDE(beyond, 1, [[1.0]]),
    lambda: line("y"),
    lambda: line("x^2"),
    lambda: line("-x", parameters={"k": 1.0}),
    lambda: filtering().predict(1.0, u={"a": 1.0}),
    lambda: sf.Sensors({"height": HEIGHT})["hight"],
    lambda: late(2.0),
    lambda: late(-1.0),
    lambda: sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["x"]]).log_likelihood(0.0, [[-1.0]]),
    lambda: setattr(filtering(), "x", [0.0, 0.0]),
    lambda: filtering().P.__setitem__((0, 0), 1.0),
    lambda: filtering().K,
    lambda: filtering().update([1.0], hx=unknown),
    lambda: filtering().update([1.0], unknown, unknown),
    lambda: sf.SPHFilter(wells(), POSITION),
    lambda: sf.SPHFilter.load("no_such_file.npz", wells(), POSITION),
    lambda: filtering().save("no_such_folder/filter.npz"),
    lambda: laid(sf.Gaussian([20.0], [[0.01]]), domain=WALLS),
    lambda: laid().probability(lambda X: 2.0 * X[:, 0]),
    lambda: sf.simulate(line("-x"), None, [0.0], [0.0, 1.0], rng="seed"),
    lambda: sf.propagate(laid(), line("-x"), [2.0, 1.0]),
    lambda: switched(100.0, 0.01, 1.0, [50.0]),
    lambda: sf.FilterConfig(target_eror=1.0),
    lambda: sf.FilterConfig(target_error=-1.0),
    lambda: sf.FilterConfig(scheme="papr"),
]

COMMANDS = [
    "run dufing",
    "run duffing --filters ekff",
    "run duffing --set kernel",
    "run duffing --set model.drfit=3",
    "run cart --filters grid",
    "run duffing --filters kf",
    "filter --model nothing.toml --data nothing.csv",
    "transient duffing --animate film.txt",
]
