"""C_CFL, C_NNS and M_B of the published scheme, with the search bypassed and not (002 4.4-4.5)."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from experiments.scene.files import changes_of
from experiments.show.tables import number, table
from experiments.terminal.options import numbers
from experiments.terminal.running import tell
from sphfilter.errors import ConfigError

from . import calibration_plots, tables
from .cells import UNKNOWN, Cell
from .errors import MEASURES, Errors, errors_of
from .studies import scheme_change
from .transient import progress, scheme_keys, setting_of, told_truth

__all__ = ["PUBLISHED", "Pair", "Plan", "pairs_of", "study"]

#: Per cent of the run time that 002 saved on average, by its number of particles.
PUBLISHED = {1245: 48, 2617: 56}


@dataclass(frozen=True)
class Plan:
    """What is tried: C_CFL alone and on a grid with C_NNS for each number of particles, then M_B."""

    counts: tuple = (1245, 2617)
    c_cfl: tuple = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0)
    of_grid: tuple = (0.05, 0.1, 0.25, 0.5)
    c_nns: tuple = (0.5, 0.75, 1.0, 1.25, 1.5)
    grid_buffer: int = 12
    buffer_count: int = 1674
    buffers: tuple = (4, 8, 12, 16, 20)  # 002 has 0 too, which is no bypass at all
    buffer_cfl: float = 0.2
    end: float = 1.0
    repeats: int = 3

    def variants(self):
        """Runs without bypass, each with those of the same particles and steps with it.

        Yields
        ------
        (int, float), list of (float, int)
            Particles and C_CFL; C_NNS and M_B.
        """
        for count in self.counts:
            for c in self.c_cfl:
                ratios = self.c_nns if c in self.of_grid else (1.0,)
                yield (count, c), [(ratio, self.grid_buffer) for ratio in ratios]
        yield (self.buffer_count, self.buffer_cfl), [(1.0, buffer) for buffer in self.buffers]


_QUICK = Plan(
    counts=(300,), c_cfl=(0.25, 0.5), of_grid=(0.25, 0.5), c_nns=(0.5, 1.0, 1.5), buffer_count=300, end=0.5,
    buffers=(4, 8, 16), repeats=1,
)  # fmt: skip


@dataclass(frozen=True)
class Pair:
    """The same run with the search bypassed and not.

    Attributes
    ----------
    label : dict
        particles, c_cfl, c_nns, buffer.
    off, on : Cell
        Without and with bypass, of the first repeat.
    seconds_off, seconds_on : float
        Processor time, medians over the repeats.
    saved : float
        Per cent of it, median over the repeats of runs that followed each other.
    difference : Errors
        Of the two densities from each other.
    """

    label: dict
    off: Cell
    on: Cell
    seconds_off: float
    seconds_on: float
    saved: float
    difference: Errors

    def row(self):
        """A flat dict, for a file."""
        own = {key: getattr(self, key) for key in ("seconds_off", "seconds_on", "saved")}
        pair = {
            f"{name}_{which}": getattr(cell.errors, name)
            for which, cell in (("off", self.off), ("on", self.on))
            for name in ("mean", "cov", "l2")
        }
        apart = {f"difference_{name}": getattr(self.difference, name) for name in ("mean", "cov", "l2")}
        counts = {"n_steps": self.on.n_steps, "bypass_ratio": self.on.bypass_ratio}
        return self.label | pair | apart | counts | own | {"failure": self.off.failure or self.on.failure}


def pairs_of(setting, truth, plan, keys, told):
    """Run a plan.

    Parameters
    ----------
    setting : Setting
    truth : Truth
    plan : Plan
    keys : dict
        Other settings of the published scheme.
    told : callable(label)
        Called before every run.

    Returns
    -------
    list of Pair
    """
    found = []
    for (count, c_cfl), variants in plan.variants():
        base = {"particles": count, "c_cfl": c_cfl}
        off, on = [], {variant: [] for variant in variants}
        for _ in range(plan.repeats):
            off.append(_run(setting, truth, base | {"bypass": "off"}, keys, told))
            for c_nns, buffer in variants:
                label = base | {"c_nns": c_nns, "buffer": buffer}
                on[c_nns, buffer].append(_run(setting, truth, label, keys, told))
        found += [_pair(off, cells, truth) for cells in on.values()]
    return found


def _run(setting, truth, label, keys, told):
    told(label)
    bypassing = label.get("bypass") != "off"
    own = {"kernel": "gaussian", "c_cfl": label["c_cfl"], "bypass": bypassing} | keys
    if bypassing:
        own |= {"c_nns": label["c_nns"], "buffer_neighbors": label["buffer"]}
    changes = scheme_change("paper", own) | {"solver.n_particles": label["particles"]}
    return setting.run(label, changes, truth)


def _pair(off, on, truth):
    seconds = np.array([[cell.cpu_seconds for cell in cells] for cells in (off, on)])
    failed = off[0].failure or on[0].failure
    apart = UNKNOWN if failed else errors_of(on[0].densities, truth.seen_by(off[0].densities))
    saved = 100.0 * (1.0 - np.median(seconds[1] / seconds[0]))
    return Pair(on[0].label, off[0], on[0], *np.median(seconds, axis=1).tolist(), float(saved), apart)


def study(args, console):
    """`--calibrate`."""
    changes, keys = scheme_keys(changes_of(args))
    plan = _plan(args)
    setting = setting_of(args.scenario or "van_der_pol", changes, plan.end, args.limit)
    setting.with_changes(scheme_change("paper", keys)).check()
    truth = told_truth(console, setting)
    n_runs = plan.repeats * sum(1 + len(variants) for _, variants in plan.variants())
    with progress(console, n_runs) as told:
        pairs = pairs_of(setting, truth, plan, keys, told)
    measure = "l2" if truth.nodes else "cov"
    console.print(_table(f"{setting.problem.name} to {plan.end:g} s, published scheme", pairs, measure))
    tell(console, sentences(pairs, plan, measure))
    draw = partial(calibration_plots.draw, pairs=pairs, plan=plan, truth=truth.name, measure=measure)
    cells, rows = (cell for pair in pairs for cell in (pair.off, pair.on)), [pair.row() for pair in pairs]
    tables.end(console, args, f"calibrate_{setting.problem.name}", "calibration", cells, rows, draw)


def _plan(args):
    plan = _QUICK if args.quick else Plan()
    changes = {key: value for key in ("end", "repeats") if (value := getattr(args, key)) is not None}
    if changes.get("repeats", 1) < 1:
        raise ConfigError("--repeats is one at least")
    if args.counts:
        changes["counts"] = tuple(numbers("--counts", args.counts, int))
        changes["buffer_count"] = changes["counts"][0]
    return Plan(**(vars(plan) | changes))


def _table(title, pairs, measure):
    headings = ("particles", "C_CFL", "C_NNS", "M_B", MEASURES[measure], "change of it", "on from off",
                "ratio", "off, cpu s", "on, cpu s", "saved")  # fmt: skip
    made = table(title, headings, left=0)
    for pair in pairs:
        off, apart = getattr(pair.off.errors, measure), getattr(pair.difference, measure)
        seconds = pair.seconds_off, pair.seconds_on
        values = (off, _change(pair, measure), apart, pair.on.bypass_ratio, *seconds)
        saved = number(pair.saved, ".0f", " %")
        label = (f"{pair.label[key]:g}" for key in ("particles", "c_cfl", "c_nns", "buffer"))
        made.add_row(*label, *(number(value, ".2g") for value in values), saved)
    return made


def _change(pair, measure):
    """How much larger the error is with bypass."""
    return getattr(pair.on.errors, measure) - getattr(pair.off.errors, measure)


def sentences(pairs, plan, measure):
    """What came out, beside what was published."""
    done = [pair for pair in pairs if np.isfinite(pair.saved)]
    for count in plan.counts:
        saved = [pair.saved for pair in done if pair.label["particles"] == count]
        if saved:
            beside = f"; published: {PUBLISHED[count]} % on average" if count in PUBLISHED else ""
            spread = f"{min(saved):.0f} to {max(saved):.0f}"
            yield f"{count} particles: bypassing saves {np.mean(saved):.0f} % ({spread}){beside}"
    if done:
        change = max(abs(_change(pair, measure)) for pair in done)
        same = " (not by one bit)" if change == 0.0 else ""
        yield f"the error ({MEASURES[measure]}) changes by at most {change:.1g}{same}; published: about 1e-7"
    tried = [pair for pair in done[-len(plan.buffers) :] if pair.label["particles"] == plan.buffer_count]
    if tried:
        best = max(tried, key=lambda pair: pair.saved)
        found = f"the best M_B is {best.label['buffer']}, which saves {best.saved:.0f} %"
        yield f"{found}; published: {calibration_plots.PUBLISHED_BUFFER}"
