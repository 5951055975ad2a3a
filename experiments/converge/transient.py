"""Studies of a transient solution over particles, schemes and time steps: run, shown and written."""

from contextlib import contextmanager
from pathlib import Path

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.scene.files import changes_of
from sphfilter.errors import ConfigError

from . import plots, tables
from .cells import SCHEME, Setting, cut
from .studies import INTEGRATORS, by_scheme, by_step, default_steps, scheme_change, variants
from .truth import truth_of

__all__ = ["progress", "scheme_keys", "setting_of", "study_schemes", "study_steps", "told_truth"]

_END = 6.0  # seconds: errors of a density come from its first oscillations
_N_PARTICLES = 400
_SCHEMES = "log_density", "corrected", "paper"


def study_schemes(args, console, counts):
    """`--over particles` and `--over scheme`."""
    changes, keys, names = changes_of(args), {}, None
    if args.over == "scheme":
        changes, keys = scheme_keys(changes)
        names = (args.schemes or ",".join(_SCHEMES)).split(",")
    setting = setting_of(args.scenario, changes, _END if args.end is None else args.end, args.limit)
    schemes = variants(setting, names, keys)
    truth = told_truth(console, setting)
    with progress(console, len(counts) * len(schemes)) as told:
        cells = by_scheme(setting, truth, counts, schemes, told)
    dim, title = setting.problem.model.dim, _title(setting, truth)
    console.print(tables.scheme_table(title, cells, dim))
    out = _folder(args, setting)
    tables.write_rows(out / "convergence.csv", cells)
    drawn = plots.draw_schemes(out / "convergence.png", title, cells, truth, dim)
    _end(console, cells, out / "convergence.csv", drawn)


def study_steps(args, console, rule, values):
    """`--over step`; `values` of a rule of `RULES`, or None for fixed steps that suit the problem."""
    changes, keys = scheme_keys(changes_of(args))
    changes["solver.n_particles"] = args.n_particles or _N_PARTICLES
    setting = setting_of(args.scenario, changes, _END if args.end is None else args.end, args.limit)
    setting.with_changes(scheme_change("paper", keys)).check()
    values = values or default_steps(setting, keys)
    if len(values) < 2:
        raise ConfigError("--over step needs two different steps at least")
    truth = told_truth(console, setting)
    with progress(console, len(INTEGRATORS) * len(values) + 1) as told:
        rows = by_step(setting, truth, rule, values, keys, told)
    title = f"{_title(setting, truth)}, published scheme"
    console.print(tables.step_table(title, rows, rule))
    out, cells = _folder(args, setting), [cell for cell, _ in rows]
    written = [
        tables.row_of(cell) | {f"step_{m}": getattr(own, m) for m in tables.MEASURES} for cell, own in rows
    ]
    tables.write_rows(out / "steps.csv", written)
    _end(console, cells, out / "steps.csv", plots.draw_steps(out / "steps.png", title, rows, truth, rule))


def setting_of(name, changes, end, limit):
    """The `Setting` of a transient scenario that ends at `end` at the latest."""
    if name is None:
        raise ConfigError("name a transient scenario from `list`, such as oscillator_underdamped")
    if end <= 0 or limit <= 0:
        raise ConfigError(f"--end and --limit are seconds above zero, not {min(end, limit):g}")
    return Setting(name, cut(name, changes, end), limit)


def scheme_keys(changes):
    """Changes without those of the scheme, and these as settings of schemes.

    Raises
    ------
    ConfigError
        A scheme is asked for: the study sets it itself.
    """
    if SCHEME in changes or f"{SCHEME}.name" in changes:
        raise ConfigError(
            f"this study sets {SCHEME} itself; --set {SCHEME}.KEY=VALUE changes a setting of the schemes"
        )
    own = {key.removeprefix(f"{SCHEME}."): v for key, v in changes.items() if key.startswith(f"{SCHEME}.")}
    return {key: v for key, v in changes.items() if not key.startswith(f"{SCHEME}.")}, own


def told_truth(console, setting):
    """The truth of a setting's problem; the console is told what it is."""
    problem = setting.problem
    console.print(f"[bold]{problem.name}[/]: {escape(problem.settings.description)}")
    with Progress(TextColumn("reference"), BarColumn(), console=console, transient=True) as bar:
        task = bar.add_task("", total=None)
        truth = truth_of(problem, lambda done, total: bar.update(task, completed=done, total=total))
    if truth.doubt is not None:
        known = ", ".join(
            f"{name} {tables.number(getattr(truth.doubt, m))}" for m, name in tables.MEASURES.items()
        )
        console.print(f"{truth.name}, its own errors at most: {known}", style="dim")
    return truth


@contextmanager
def progress(console, n_cells):
    """A bar, or a line a cell where there is no terminal; yields what is to be told of each cell."""
    console.print("running (the first time compiles, for a minute a scheme)", style="dim")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=n_cells)
        count = iter(range(n_cells + 1))

        def told(label):
            text = ", ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in label.items()
            )
            bar.update(task, completed=next(count, n_cells), description=text)
            if not console.is_terminal:
                console.print(text, style="dim")

        yield told


def _title(setting, truth):
    times = setting.problem.times
    return f"{setting.problem.name} against the {truth.name}, rms over {len(times)} times to {times[-1]:g} s"


def _folder(args, setting):
    out = args.out or Path("results") / f"converge_{setting.problem.name}"
    out.mkdir(parents=True, exist_ok=True)
    return out


def _end(console, cells, *paths):
    for sentence in tables.failures(cells):
        console.print(f"• {escape(sentence)}")
    console.print(f"Table and picture: {', '.join(str(path) for path in paths)}")
