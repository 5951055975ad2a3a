"""A user's own transient file: every key with a bad value is refused in one sentence that names it."""

import re
import tomllib

import pytest
import tomli_w
from transient_help import EXAMPLE

from experiments.__main__ import main
from experiments.transient.grids import Lattice, Probe, Written
from experiments.transient.settings import Begin, Output, Reference, Solver, Statistics

LATTICE = {"origin": [-1.2, -1.2], "size": [2.4, 2.4], "spacing": 0.1}
CASES = [
    ("modell", {}, "unknown key modell .did you mean 'model'"),
    ("description", 3, "description = 3"),
    ("source", [1], "source ="),
    ("published", "fast", "published = 'fast'"),
    ("axes", [0, 2], r"axes = \[0, 2\] must be .* numbered 0 to 1"),
    ("axes", [0, 1, 0], r"axes = \[0, 1, 0\]"),
    ("axes", "x", "axes = 'x'"),
    ("steady", [{"powers": [2], "value": 1.0}], r"steady\[0\].powers needs 2 entries"),
    ("steady", [{"powers": [2, 0]}], "steady.0.value is missing"),
    ("model.drfit", 1, "unknown key model.drfit .did you mean 'drift'"),
    ("model.states", "x", "model.states = 'x'"),
    ("model.states", ["x", 3], "model.states.1 = 3"),
    ("model.states", ["x", "t"], "model.states: 't' has a meaning of its own"),
    ("model.states", ["x", "x"], "model.states: .*'x' is given twice"),
    ("model.states", ["x", "v", "w"], "model: units must name each of the 3 states"),
    ("model.units", ["m"], "model: units must name each"),
    ("model.labels", ["place"], "model: labels must name each"),
    ("model.drift", "v", "model.drift = 'v'"),
    ("model.drift", ["v"], "model.drift has 1 expressions, but there are 2 states"),
    ("model.drift", ["v", "-q"], r"model.drift\[1\] '-q': unknown name 'q'"),
    ("model.drift", ["v", "-(x"], r"model.drift\[1\] .* cannot be read: .* was never closed"),
    ("model.drift", ["v", "x^2"], r"model.drift\[1\] .*use \*\* for powers"),
    ("model.drift", ["v", "if(x, 1, 2)"], r"model.drift\[1\] .*where"),
    ("model.drift", ["v", "__import__('os').getcwd()"], r"model.drift\[1\]"),
    ("model.noise", [["0"]], "model.noise must be 2 equally long rows"),
    ("model.noise", [["0"], ["w"]], r"model.noise\[1\]\[0\] 'w': unknown name 'w'"),
    ("model.noise", 1, "model.noise = 1"),
    ("model.spectral_density", [[-1.0]], "model.spectral_density is not positive"),
    ("model.spectral_density", [[1, 0], [0, 1]], "model.spectral_density has shape"),
    ("model.diffusion", [["0", "0"], ["0", "1"]], "model: Give either noise= .* or diffusion="),
    ("model.parameters", {"c": "large"}, "model.parameters.c = 'large'"),
    ("model.parameters", {"c": 1.0, "x": 1.0}, "model.parameters: .*'x' is given twice"),
    ("model.interpretation", "itto", "model.interpretation = 'itto'"),
    ("model.domain", ["unbounded"], "model.domain has 1 axes, but there are 2 states"),
    ("model.domain", ["infinite", "unbounded"], "model.domain.0: an axis is .* got 'infinite'"),
    ("model.domain", [["ring", 0, 1], "unbounded"], "axis 0 of the domain must be one of .* 'ring'"),
    ("model.domain", [["bounded", 1, -1], "unbounded"], "axis 0 of the domain must rise from low to high"),
    ("model.domain", [["periodic", 0, "none"], "unbounded"], "axis 0 of .* finite if it is periodic"),
    ("model.domain", [["bounded", 0], "unbounded"], "model.domain.0"),
    ("start.latice", LATTICE, "unknown key start.latice .did you mean 'lattice'"),
    ("start.kind", "gausian", "start.kind = 'gausian'"),
    ("start.kind", "gaussian", 'start: kind = "gaussian" needs mean'),
    ("start.mean", [0.0, 0.0], 'start: kind = "expression" has no mean'),
    ("start", {"mean": [0.0], "cov": [[1.0, 0.0], [0.0, 1.0]]}, "start.mean needs 2 entries"),
    ("start", {"mean": [0.0, 0.0], "cov": [[1.0, 2.0], [2.0, 1.0]]}, "start.cov is not positive definite"),
    ("start", {"mean": [0.0, 0.0], "cov": [[1.0, 0.0]]}, "start.cov needs 2 entries"),
    ("start", {"mean": "here", "cov": [[1.0]]}, "start.mean = 'here'"),
    ("start", {"kind": "uniform", "box": [[1.0, 0.0], [0.0, 1.0]]}, "start.box must hold .* low < high"),
    ("start", {"kind": "uniform", "box": [[0.0, 1.0]]}, "start.box needs 2 entries"),
    ("start", {"kind": "uniform", "box": [[0.0], [1.0]]}, "start.box.0"),
    ("start.box", [[0.0, 1.0], [0.0, 1.0]], "start: a lattice has a box of its own"),
    ("start.pdf", 3, "start.pdf = 3"),
    ("start.pdf", "x +", "start.pdf 'x [+]' cannot be read"),
    ("start.pdf", "exp(-q)", "start.pdf 'exp.-q.': unknown name 'q'"),
    ("start.pdf", "x > 1", "start.pdf 'x > 1' is a condition"),
    ("start.pdf", "0*x", "start.pdf is zero everywhere"),
    ("start.pdf", "-1", "start.pdf must return one finite density >= 0"),
    ("start.time", "now", "start.time = 'now'"),
    ("start.time", 99.0, "times.end .* after start.time = 99"),
    ("start.reach", 1.0, "start.reach = 1.0"),
    ("start.reach", 4.0, "start: a lattice has a box .* leave out box and reach"),
    ("start.lattice", 3, "start.lattice = 3"),
    ("start.lattice.spcing", 1, "unknown key start.lattice.spcing .did you mean 'spacing'"),
    ("start.lattice.origin", [0.0], "start.lattice: origin has 1 values, but size 2"),
    ("start.lattice", {"origin": [0.0], "size": [1.0], "spacing": 0.1}, "start.lattice.origin needs 2"),
    ("start.lattice.size", [1.0, -1.0], "start.lattice: size must be positive"),
    ("start.lattice.spacing", -0.1, "start.lattice: spacing must be positive .* got -0.1"),
    ("start.lattice.spacing", 3.0, "start.lattice: spacing must be .* no longer than size, got 3.0"),
    ("start.lattice.spacing", [0.1], "start.lattice: origin has 2 values, but spacing 1"),
    ("start.lattice.spacing", "fine", "start.lattice.spacing = 'fine'"),
    ("start.lattice.spacing", 1e-5, "start.lattice.spacing = .* nodes, more than 2e"),
    ("times.intervall", 1.0, "unknown key times.intervall .did you mean 'interval'"),
    ("times.end", "late", "times.end = 'late'"),
    ("times.end", -1.0, "times.end and times.interval, .* give no time of output"),
    ("times.interval", -1.0, "times.interval = -1.0"),
    ("times.interval", 99.0, "times.end and times.interval, .* give no time of output"),
    ("times.at", [1.0], "times: give either at, or end and interval"),
    ("times", {"at": [1.0, 0.5]}, r"times.at must not decrease.*\[1.0, 0.5\]"),
    ("times", {"at": [-1.0]}, "times.at must not decrease, nor begin before start.time = 0"),
    ("times.drawn", 3, "times.drawn = 3"),
    ("solver.n_particle", 1, "unknown key solver.n_particle .did you mean 'n_particles'"),
    ("solver.n_particles", 0, "solver.n_particles = 0"),
    ("solver.n_particles", "many", "solver.n_particles = 'many'"),
    ("solver.n_particles", 10, "lays 437 particles, more than n_particles = 10"),
    ("solver.config", 1, "solver.config = 1"),
    ("solver.config.shceme", "auto", "unknown key solver.config.shceme .did you mean 'scheme'"),
    ("solver.config.exact_linear", "maybe", "solver.config.exact_linear = 'maybe'"),
    ("solver.config.scheme", "papr", "solver.config.scheme: .* 'papr' .did you mean 'paper'"),
    ("solver.config.scheme", "log_density", 'start.lattice is for schemes .* not "log_density"'),
    *(
        (f"solver.config.scheme.{key}", value, f"solver.config.scheme: {sentence}")
        for key, value, sentence in [
            ("name", "papier", "there is no scheme 'papier' .did you mean 'paper'"),
            ("kernel", "gausian", "kernel = 'gausian' .*'gaussian'"),
            ("support_range", [3.0, 2.0], "support_range must rise"),
            ("support_range", 3.6, "support_range = 3.6"),
            ("smoothing", "newtn", "smoothing = 'newtn'"),
            ("smoothing_tolerance", 0, "smoothing_tolerance = 0"),
            ("smoothing_iterations", 0, "smoothing_iterations = 0"),
            ("discard_unconverged", "perhaps", "discard_unconverged = 'perhaps'"),
            ("integrator", "leapfrog", "integrator = 'leapfrog'"),
            ("cfl", "rel", "cfl = 'rel'"),
            ("c_cfl", -1.0, "c_cfl = -1.0"),
            ("dt_max", 0.0, "dt_max = 0.0"),
            ("couplin", 1.2, "unknown key couplin"),
            ("maxNeighbors", 200, "unknown key maxNeighbors .did you mean 'buffer_neighbors'"),
            ("cellScale", 1.0, "unknown key cellScale"),
        ]
    ),
    ("statistics.exceedence", [], "unknown key statistics.exceedence .did you mean 'exceedance'"),
    ("statistics.moments", [2], "statistics.moments.0 = 2"),
    ("statistics.moments", [[2, 0], [1]], r"statistics.moments\[1\] needs 2 entries"),
    ("statistics.moments", [[-1, 0]], "statistics.moments.0.0 = -1"),
    ("statistics.exceedance", "x > 1", "statistics.exceedance = 'x > 1'"),
    ("statistics.exceedance", ["x >"], r"statistics.exceedance\[0\] 'x >' cannot be read"),
    ("statistics.exceedance", ["x + 1"], r"statistics.exceedance\[0\] .* is a number"),
    ("statistics.exceedance", ["x > 1", "w > 1"], r"statistics.exceedance\[1\] .*unknown name 'w'"),
    ("statistics.cumulants", [1], "statistics.cumulants.0 = 1"),
    ("statistics.cumulants", [2], "statistics.cumulants needs a Gaussian or uniform start"),
    ("output.evry", 1, "unknown key output.evry .did you mean 'every'"),
    ("output.every", 0, "output.every = 0"),
    ("output.interval", -1, "output.interval = -1"),
    ("output.interval", 0.5, "output: give either every or interval"),
    ("output.csv", "some", "output.csv = 'some'"),
    ("probe.spaceing", 1, "unknown key probe.spaceing .did you mean 'spacing'"),
    ("probe.origin", [0.0], "probe: origin has 1 values, but size 2"),
    ("probe", {"origin": [0.0], "size": [1.0], "spacing": 0.1}, "probe.origin needs 2 entries"),
    ("probe.size", [0.0, 0.0], "probe: size must be positive, or zero along some states"),
    ("probe.size", [1.0, -1.0], "probe: size must be positive"),
    ("probe.spacing", 0.0, "probe: spacing must be positive"),
    ("probe.spacing", 99.0, "probe: spacing must be .* no longer than size"),
    ("probe.spacing", 1e-4, "probe: spacing = 0.0001 makes .* points; at most 1e"),
    ("probe.data", "density", "probe.data = 'density'"),
    ("probe.data", ["densty"], "probe.data.0 = 'densty'"),
    ("probe.data", [], "probe: data must name one quantity"),
    ("probe.fps", 0, "probe.fps = 0"),
    ("reference.kind", "mc", "reference.kind = 'mc'"),
    ("reference.kind", "linear", 'reference.kind = "linear" needs a linear model'),
    ("reference.kind", "grid", 'reference.kind = "grid" needs'),
    ("reference.kind", "drifted_uniform", 'reference.kind = "drifted_uniform" needs one state'),
    ("reference.n_paths", 5, "reference.n_paths = 5"),
    ("reference.step", -1, "reference.step = -1"),
    ("reference.size", "a", "reference.size = 'a'"),
]


@pytest.mark.parametrize(("key", "value", "sentence"), CASES, ids=[f"{k}={v}"[:40] for k, v, _ in CASES])
def test_bad_values_are_refused_in_one_sentence_that_names_the_key(key, value, sentence, tmp_path, capsys):
    at = tree = tomllib.loads(EXAMPLE)
    *above, last = key.split(".")
    for part in above:
        at = at[part]
    at[last] = value
    path = tmp_path / "my.toml"
    path.write_text(tomli_w.dumps(tree), encoding="utf-8")
    assert main(["transient", "--config", str(path), "--out", str(tmp_path / "out")]) == 1
    message = capsys.readouterr().err
    assert message.startswith("error: ") and message.count("\n") == 1
    assert re.search(sentence, message), message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("table", "cls"),
    [
        ("start", Begin), ("start.lattice", Lattice), ("times", Output), ("solver", Solver), ("probe", Probe),
        ("statistics", Statistics), ("output", Written), ("reference", Reference),
    ],
)  # fmt: skip
def test_no_key_is_left_out_above(table, cls):
    for name in cls.__dataclass_fields__:
        key = f"{table}.{name}"
        assert any(re.search(key, sentence) or k.startswith(key) for k, _, sentence in CASES), key
