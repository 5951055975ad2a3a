"""`converge` for transient densities: orders over particles and steps, refusals."""

import numpy as np
import pytest
from csv_rows import csv_rows
from scipy.stats import multivariate_normal

import sphfilter as sf
from experiments.__main__ import main
from experiments.converge.cells import Setting, cut
from experiments.converge.errors import Truth, errors_of
from experiments.converge.studies import by_scheme, by_step, default_steps, variants
from experiments.converge.tables import fitted_order, orders_of
from experiments.converge.truth import quadrature, truth_of

QUIET = {"told": lambda label: None}


def setting(name, end, limit=np.inf, **changes):
    return Setting(name, cut(name, {key.replace("__", "."): v for key, v in changes.items()}, end), limit)


class Normal:
    """A Gaussian under the names of a particle density's."""

    def __init__(self, mean, cov):
        self._mean, self._cov = np.array(mean), np.array(cov)
        self.pdf = multivariate_normal(mean, cov).pdf

    def mean(self):
        return self._mean

    def cov(self):
        return self._cov


def test_orders_are_slopes_with_their_standard_errors():
    x = np.array([1.0, 2.0, 4.0, 8.0])
    exact = fitted_order(x, 3.0 * x**-1.5)
    assert exact.slope == pytest.approx(-1.5) and exact.spread < 1e-12
    rng = np.random.default_rng(1)
    found = [fitted_order(x, x**2 * np.exp(0.1 * rng.standard_normal(4))) for _ in range(2000)]
    slopes, spreads = np.array(found).T
    assert np.mean(slopes) == pytest.approx(2.0, abs=0.01)
    assert np.sqrt(np.mean(spreads**2)) == pytest.approx(np.std(slopes), rel=0.05)
    assert np.isnan(fitted_order([1.0], [1.0]).slope) and str(fitted_order([1.0], [1.0])) == "-"
    assert str(fitted_order([1.0, 2.0, np.nan], [1.0, 4.0, 1.0])) == "2.00"


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_errors_of_gaussians_are_those_of_closed_forms(dim):
    """Equal covariances C, means d apart: H² = 1 - exp(-d'C⁻¹d/8), and L2² = 2 - 2 exp(-d'C⁻¹d/4)."""
    if dim == 2:
        exact = truth_of(setting("oscillator_underdamped", 1.0).problem)
    else:
        cov = np.diag(np.arange(1.0, dim + 1.0))
        X, w = quadrature(np.zeros(dim), cov)
        values = multivariate_normal(np.zeros(dim), cov).pdf(X)
        exact = Truth("closed form", np.zeros((1, dim)), cov[None], (X,), (values,), (w,))
    mean, cov = exact.mean[0], exact.cov[0]
    shift = 0.3 * np.linalg.cholesky(cov)[:, 0]
    found = errors_of([Normal(mean + shift, cov)] * len(exact.mean), exact)
    close = {"rel": 1e-6 if dim < 3 else 0.02}
    assert found.mean == pytest.approx(0.3) and found.cov == pytest.approx(0.0, abs=1e-12)
    assert found.hellinger**2 == pytest.approx(1 - np.exp(-0.09 / 8), **close)
    assert found.l2**2 == pytest.approx(2 - 2 * np.exp(-0.09 / 4), **close)
    wide = errors_of([Normal(mean, 1.21 * cov)] * len(exact.mean), exact)
    assert wide.cov == pytest.approx(0.21) and wide.mean == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "end"), [("van_der_pol", 1.0), ("brownian_drift", 0.5), ("cart_linear", 1.0)]
)
def test_truths_of_all_kinds_have_unit_mass_and_their_own_moments(name, end):
    changes = {"reference__size": 64} if name == "van_der_pol" else {}
    truth = truth_of(setting(name, end, **changes).problem)
    for X, p, w, mean, cov in zip(
        truth.nodes, truth.values, truth.weights, truth.mean, truth.cov, strict=True
    ):
        assert w @ p == pytest.approx(1.0, abs=3e-3)
        assert (w * p) @ X == pytest.approx(mean, abs=5e-3)
        d = X - mean
        assert (d * (w * p)[:, None]).T @ d == pytest.approx(cov, abs=1e-2 * np.trace(cov))
    assert (truth.doubt is None) == (name != "van_der_pol")
    assert truth.doubt is None or truth.doubt.l2 < 1e-3


def test_orders_over_particles_on_the_linear_oscillator():
    """Kernel sums are of second order in the spacing."""
    study = setting("oscillator_underdamped", 1.0, start__reach=6.0)
    truth = truth_of(study.problem)
    keys = {"kernel": "gaussian", "support_range": [3.6, 3.6], "integrator": "midpoint"}
    cells = by_scheme(study, truth, [100, 200, 400], variants(study, ["paper"], keys), **QUIET)
    found = orders_of([(cell.n_particles, cell.errors) for cell in cells], "particles", dim=2)
    assert found["cov"].slope == pytest.approx(2.0, abs=0.4)
    assert found["l2"].slope == pytest.approx(2.0, abs=0.4)


def test_orders_over_the_time_step():
    """Textbook orders where smoothing lengths are kept; (14) lags a step, which is of first order in h."""
    study = setting("oscillator_underdamped", 1.0, solver__n_particles=150)
    truth, steps = truth_of(study.problem), [0.1, 0.05, 0.025]
    for smoothing, rk4 in (("fixed", 4.0), ("proportional", 1.0)):
        rows = by_step(study, truth, "step", steps, {"smoothing": smoothing}, **QUIET)
        found = {
            name: orders_of(
                [(c.label["step"], own) for c, own in rows if c.label["integrator"] == name], "step"
            )
            for name in ("euler", "midpoint", "rk4")
        }
        assert found["euler"]["mean"].slope == pytest.approx(1.0, abs=0.15)
        assert found["midpoint"]["mean"].slope == pytest.approx(2.0, abs=0.15)
        assert found["rk4"]["mean"].slope == pytest.approx(4.0, abs=0.3)
        assert found["euler"]["cov"].slope == pytest.approx(1.0, abs=0.25)
        assert found["rk4"]["cov"].slope == pytest.approx(rk4, abs=0.4)


def test_steps_by_their_courant_number_have_the_order_of_the_integrator():
    study = setting("oscillator_underdamped", 0.5, solver__n_particles=100, times__interval=0.5)
    rows = by_step(study, truth_of(study.problem), "c_cfl", [0.8, 0.4], {"smoothing": "fixed"}, **QUIET)
    ratio = {c.label["integrator"]: [] for c, _ in rows}
    for cell, own in rows:
        ratio[cell.label["integrator"]].append(own.mean)
    assert ratio["euler"][0] / ratio["euler"][1] == pytest.approx(2.0, rel=0.15)
    assert ratio["midpoint"][0] / ratio["midpoint"][1] == pytest.approx(4.0, rel=0.2)


def test_default_steps_are_stable_parts_of_an_interval():
    study = setting("van_der_pol", 1.0, solver__n_particles=150, reference__size=64)
    steps = default_steps(study, {})
    assert len(steps) == 4 and steps == sorted(steps, reverse=True)
    assert all((1.0 / step) == pytest.approx(round(1.0 / step)) for step in steps)
    truth = truth_of(study.problem)
    assert not any(cell.failure for cell, _ in by_step(study, truth, "step", steps[:2], {}, **QUIET))


def test_a_cell_that_fails_is_a_sentence_and_the_others_go_on():
    study = setting("oscillator_underdamped", 2.0)
    truth = truth_of(study.problem)
    failed, done = by_scheme(study, truth, [4, 100], variants(study, ["log_density"], {}), **QUIET)
    assert "n_particles = 4 is too small" in failed.failure and np.isnan(failed.errors.cov)
    assert not done.failure and done.errors.cov < 1e-3
    slow = setting("oscillator_underdamped", 2.0, limit=1e-9)
    cell = slow.run({}, {}, truth)
    assert "given up" in cell.failure and "t = 1 of 2" in cell.failure and "--limit" in cell.failure


@pytest.mark.parametrize(
    ("arguments", "file", "n_rows"),
    [
        (["oscillator_critical", "--end", "2", "--counts", "100,200"], "convergence", 2),
        (["cart_linear", "--over", "scheme", "--end", "1", "--counts", "200,400",
          "--schemes", "log_density"], "convergence", 2),
        (["oscillator_critical", "--over", "step", "--end", "1", "--n-particles", "100",
          "--steps", ".1,.05"], "steps", 6),
    ],
)  # fmt: skip
def test_commands_write_table_and_picture(arguments, file, n_rows, tmp_path, capsys):
    assert main(["converge", *arguments, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"{file}.csv" in said and f"{file}.png" in said
    rows = csv_rows(tmp_path / f"{file}.csv")
    assert len(rows) == n_rows and not any(row["failure"] for row in rows)
    assert (tmp_path / f"{file}.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["oscillator", "--runs", "2"], "--runs has no meaning for --over particles, which takes --counts"),
        (["linear_underdamped", "--steps", ".1"], "--steps has no meaning for a filter scenario"),
        (["--sensors", "--over", "nodes"], "are different studies"),
        (["--over", "particles"], "name a transient scenario"),
        (["oscilator", "--over", "step"], "did you mean 'oscillator'"),
        (["oscillator", "--counts", "100"], "two different counts"),
        (["oscillator", "--counts", "0,100"], "above zero"),
        (["oscillator", "--over", "step", "--steps", "a"], "--steps takes numbers such as 0.1"),
        (["oscillator", "--over", "step", "--steps", ".1"], "two different steps"),
        (["oscillator", "--over", "step", "--steps", ".1", "--c-cfl", ".2"], "two ways"),
        (["oscillator", "--over", "scheme", "--schemes", "papre"], "there is no scheme 'papre'"),
        (["oscillator", "--over", "step", "--set", "solver.config.scheme=paper"],
         "sets solver.config.scheme itself"),
        (["oscillator", "--over", "scheme", "--set", "solver.config.scheme.kernle=lucy"], "kernle"),
        (["oscillator", "--end", "-1"], "above zero"),
        (["oscillator", "--set", "reference.kind=none"], "needs one"),
    ],
)  # fmt: skip
def test_errors_are_sentences(arguments, message, tmp_path, capsys):
    assert main(["converge", *arguments, "--out", str(tmp_path)]) == 1
    assert message in capsys.readouterr().err


def test_the_search_is_never_bypassed_unless_asked_for():
    model = sf.SDE(drift=lambda x, t: (x[1], -x[0]), dim=2, noise=[[0.0], [1.0]], spectral_density=[[0.2]])
    config = sf.SolverConfig(scheme=sf.PaperScheme(kernel="gaussian", bypass=False))
    density = sf.initialize(sf.Gaussian([1.0, 0.0], 0.1 * np.eye(2)), 100, config)
    infos = sf.propagate(density, model, [0.5, 1.0], config).infos
    assert all(info.n_bypassed <= 1 and info.n_searches == info.n_steps for info in infos)
