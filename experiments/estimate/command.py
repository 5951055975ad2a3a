"""`python -m experiments estimate NAME`: fit parameters to a scenario's measurements by maximum evidence.

The log-evidence of the SPH filter is maximised; standard errors are those of its second derivatives. Beside
the fit its profiles are computed, the largest log-evidence for fixed values of each parameter, and a rival
model is fitted to the same measurements.
"""

import time
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

import sphfilter as sf
from experiments.arguments.estimate import guesses
from experiments.scene.files import changes_of
from experiments.show.tables import print_table, table
from experiments.terminal.running import new_console, status
from sphfilter.errors import ConfigError, SphfilterError
from sphfilter.files.write import write_json

from .plots import draw_profiles
from .problems import guess_of, problem_of, rival_of

#: Where profiles are computed, in standard errors from the estimate.
_FINE, _COARSE = (-2.5, -1.5, -0.75, 0.75, 1.5, 2.5), (-2.0, -1.0, 1.0, 2.0)
_FEW = 3  # parameters, up to which profiles are fine


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    problem = problem_of(args.scenario, args.parameters, changes_of(args), args.seed, args.n_particles)
    guess = guess_of(problem, guesses(args.guess))
    rival = rival_of(problem)
    if args.compare and rival is None:
        raise ConfigError(f"--compare knows no rival of {args.scenario}; of duffing and sunspots it does")
    out = args.out or Path("results") / f"estimate_{Path(args.scenario).stem}"
    out.mkdir(parents=True, exist_ok=True)

    console.print(f"[bold]{args.scenario}[/]: {problem.build.scenario.settings.description}")
    fit = _fitted(console, problem, guess)
    truth = {name: problem.values[name] for name in fit.names} if problem.simulated else {}
    print_table(console, _table(fit, truth))
    console.print(f"• {_sentence(fit)}")
    record = _record(args, fit, truth)
    if args.compare:
        record["comparison"] = _compared(console, problem, fit, *rival)
    if not args.no_profile:
        profiles = _profiles(console, problem, fit, args.jobs)
        record["profiles"] = {
            k: {"value": list(x), "log_evidence": list(y)} for k, (x, y) in profiles.items()
        }
        draw_profiles(out / "profiles.png", fit, profiles, truth, _title(args, fit))
    write_json(out / "fit.json", record)
    console.print(
        f"Numbers are in {out}/fit.json" + ("." if args.no_profile else ", profiles in profiles.png."),
        soft_wrap=True,
    )
    return 0 if fit.converged else 1


def _fitted(console, problem, guess):
    """Fit, and tell how it goes."""
    begin, best = time.perf_counter(), [-np.inf]
    with status(console) as say:

        def report(n, parameters, value):
            best[0] = max(best[0], value)
            if n % 10 == 1 or console.is_terminal:
                at = ", ".join(f"{name} = {v:.4g}" for name, v in parameters.items())
                seconds = time.perf_counter() - begin
                say(f"run {n}, {seconds:.0f} s: best log-evidence {best[0]:.3f}, now at {at}")

        say("preparing the filter (the first time compiles, for a minute)")
        return sf.fit_parameters(
            problem.build,
            problem.times,
            problem.z,
            guess,
            bounds=problem.bounds,
            report=report,
            inputs=problem.inputs,
        )


def _table(fit, truth):
    columns = ["estimate", "standard error", *(["truth", "off (s.e.)"] if truth else [])]
    rows = []
    for k, name in enumerate(fit.names):
        value, error = fit.estimate[name], fit.standard_error[name]
        known = [f"{truth[name]:.5g}", f"{(value - truth[name]) / error:+.2f}"] if truth else []
        correlations = (f"{c:+.2f}" for c in fit.correlation[k])
        rows.append((name, f"{value:.5g}", f"{error:.2g}", *known, *correlations))
    return table("", ["parameter", *columns, *(f"corr. {name}" for name in fit.names)], rows)


def _sentence(fit):
    return (
        f"{fit.status}: log-evidence {fit.log_evidence:.3f} nat of {fit.n_readings} readings, AIC "
        f"{fit.aic:.2f}, BIC {fit.bic:.2f}; {fit.n_evaluations} runs of the filter, log-evidence rough by "
        f"{fit.roughness:.1g} nat"
    )


def _title(args, fit):
    what = "measured" if args.scenario == "sunspots" else f"simulated, seed {args.seed}"
    return (
        f"{args.scenario} ({what}, {fit.n_readings} readings): profile log-evidence, parabola of the "
        "standard error (band), 95 % level"
    )


def _record(args, fit, truth):
    """What goes into fit.json."""
    told = ("log_evidence", "aic", "bic", "n_readings", "n_evaluations", "roughness", "status")
    return {
        "scenario": args.scenario,
        "seed": args.seed if truth else None,
        "estimate": dict(fit.estimate),
        "standard_error": dict(fit.standard_error),
        "covariance": fit.covariance.tolist(),
        "truth": truth or None,
    } | {key: getattr(fit, key) for key in told}


def _compared(console, problem, fit, name, rival):
    """Fit a rival and compare."""
    console.print(f"\nfitting a rival, {name}", style="dim")
    try:
        other = _fitted(console, rival, guess_of(rival, {}))
    except SphfilterError as problem_of_rival:
        console.print(f"{name}: {problem_of_rival}", style="red")
        return {"failed": str(problem_of_rival)}
    console.print(str(other), style="dim")
    found = sf.compare_models(
        {problem.name: fit, name: other}, problem.times, problem.z, inputs=problem.inputs
    )
    console.print(f"\n{found}\n")
    return found.as_dict()


def _profiles(console, problem, fit, jobs):
    """Values and log-evidences (K,) by parameter."""
    known = [name for name in fit.names if np.isfinite(fit.standard_error[name])]
    steps = _FINE if len(known) <= _FEW else _COARSE
    points = [(name, fit.estimate[name] + k * fit.standard_error[name]) for name in known for k in steps]
    low = {name: bounds[0] for name, bounds in problem.bounds.items()}
    points = [(name, value) for name, value in points if value > low.get(name, -np.inf)]
    done, found = 0, {name: [(fit.estimate[name], fit.log_evidence)] for name in known}
    with status(console) as say:
        say(f"profiles: {len(points)} points")
        runs = Parallel(n_jobs=jobs, return_as="generator")(delayed(_point)(problem, fit, *p) for p in points)
        for (name, value), evidence in zip(points, runs, strict=True):
            done += 1
            found[name].append((value, evidence))
            say(f"profiles: {done} of {len(points)} points")
    return {name: tuple(np.array(sorted(rows)).T) for name, rows in found.items()}


def _point(problem, fit, name, value):
    data = problem.times, problem.z
    return float(sf.profile_evidence(problem.build, *data, fit, name, [value], inputs=problem.inputs)[0])
