"""Studies of a transient solution over particles, schemes and time steps: run, shown and written."""

from contextlib import contextmanager
from functools import partial

from rich.markup import escape

from experiments.scene.files import changes_of
from experiments.show.tables import number, print_table
from experiments.terminal.progress import bar
from sphfilter.errors import ConfigError

from . import plots, tables
from .cells import SCHEME, Setting, cut, row_of
from .errors import MEASURES
from .studies import INTEGRATORS, by_scheme, by_step, default_steps, scheme_change, variants
from .truth import truth_of

_END = 6.0  # seconds: errors of a density come from its first oscillations
_N_PARTICLES = 400
_SCHEMES = "log_density", "paper"


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
    print_table(console, tables.scheme_table(title, cells, dim))
    draw = partial(plots.draw_schemes, title=title, cells=cells, truth=truth, dim=dim)
    rows = [row_of(cell) for cell in cells]
    tables.end(console, args, _folder(setting), "convergence", cells, rows, draw)


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
    print_table(console, tables.step_table(title, rows, rule))
    draw = partial(plots.draw_steps, title=title, rows=rows, truth=truth, rule=rule)
    written = [row_of(cell) | {f"step_{m}": getattr(own, m) for m in MEASURES} for cell, own in rows]
    tables.end(console, args, _folder(setting), "steps", (cell for cell, _ in rows), written, draw)


def setting_of(name, changes, end, limit):
    """The `Setting` of a transient scenario that ends at `end` at the latest."""
    if name is None:
        raise ConfigError("name a transient scenario from `list`, such as oscillator_underdamped")
    if end <= 0 or limit <= 0:
        raise ConfigError(f"--end and --limit are seconds above zero, not {min(end, limit):g}")
    return Setting(name, cut(name, changes, end), limit)


def scheme_keys(changes):
    """Changes without those of the scheme, and these as settings of schemes.

    Raises `ConfigError` if a scheme is asked for: the study sets it itself.
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
    with bar(console, "reference") as move:
        truth = truth_of(problem, move)
    if truth.doubt is not None:
        known = ", ".join(f"{name} {number(getattr(truth.doubt, m), '.2g')}" for m, name in MEASURES.items())
        console.print(f"{truth.name}, its own errors at most: {known}", style="dim")
    return truth


@contextmanager
def progress(console, n_cells):
    """A bar, or a line a cell where there is no terminal; yields what is to be told of each cell."""
    console.print("running (the first time compiles, for a minute a scheme)", style="dim")
    with bar(console, "", n_cells) as move:
        count = iter(range(n_cells + 1))

        def told(label):
            text = ", ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in label.items()
            )
            move(next(count, n_cells), text=text)
            if not console.is_terminal:
                console.print(text, style="dim")

        yield told


def _title(setting, truth):
    times = setting.problem.times
    return f"{setting.problem.name} against the {truth.name}, rms over {len(times)} times to {times[-1]:g} s"


def _folder(setting):
    return f"converge_{setting.problem.name}"
