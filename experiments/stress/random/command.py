"""`python -m experiments stress --random N`: random problems in processes of their own, with verdicts."""

from functools import cache, lru_cache, partial
from pathlib import Path

import reference_filters
import sphfilter
from experiments.show import tables as shown
from experiments.terminal.progress import bar, resumable

from ..pool import Lost, run_tasks
from ..store import digest_of, load, path_of, save
from .problems import RandomCase
from .records import Record, record_of
from .referees import LIMITS, Referee, referee
from .relations import chosen_relations, related
from .tables import failures, row_of, sections, write
from .verdicts import judge

__all__ = ["main"]

#: Seconds a reference may take; what makes the filter compile what it needs, and how long that may take.
_REFERENCE_LIMIT, _WARM, _COMPILE_LIMIT = 120.0, range(12), 1800.0
_WARM_REFERENCES = 4
#: Results of a case, in the order in which they are made.
_PARTS = "default", "reference", "relation 1", "relation 2"


def main(console, args):
    """Run the cases 0 ... N - 1 of a seed, or those named by --random-case; print and write the tables."""
    named = [(seed, RandomCase(k, args.auto)) for seed, k in args.random_case]
    pairs = [(args.seed, RandomCase(k, args.auto)) for k in range(args.random or 0)] + named
    if args.list:
        for seed, case in pairs:
            console.print(f"{seed}:{case.number} {_problem(seed, case)}", soft_wrap=True)
        return
    told = f"{shown.counted(len(pairs), 'random case')}, at most {args.limit:g} s a run"
    console.print(told, style="dim")
    _walk(console, pairs, args)
    rows = [row_of(*_judged(pair, args.out)) for pair in pairs]
    write(args.out, rows)
    for title, headings, lines in sections(rows):
        shown.print_table(console, shown.table(title, headings, lines))
    for line in failures(rows):
        console.print(line, style="red", soft_wrap=True, markup=False)
    for pair in named:
        _tell(console, pair, args.out)
    console.print(f"\nEvery case is in {args.out}/random.csv, the rest in random.md.", soft_wrap=True)


def _walk(console, pairs, args):
    """Run what is not yet on disk."""
    tasks = [
        (seed, case, part, str(args.out))
        for seed, case in pairs
        for part in _PARTS
        if _stored(args.out, seed, case, part) is None
    ]
    if tasks:
        console.print("preparing (the first time compiles, for minutes)", style="dim")
        warm = [RandomCase(number, args.auto) for number in _WARM]
        run_tasks(_compile, warm, 1, lambda case: _COMPILE_LIMIT, lambda case, result: None)
    kept, count = f"finished runs are kept in {args.out}. The same command goes on from there.", 0
    with bar(console, "runs", len(tasks), left=True) as move, resumable(lambda: kept):

        def done(task, result):
            nonlocal count
            count += 1
            seed, case, part, out = task
            if isinstance(result, Lost):
                lost = Referee(why=result.sentence)
                if part != "reference":
                    lost = Record("timeout" if result.timeout else "crash", result.sentence)
                _save(out, seed, case, part, lost)
            move(count, text=f"{seed}:{case.number} {part}")
            if not console.is_terminal and (count % 10 == 0 or count == len(tasks)):
                console.print(f"{count} of {shown.counted(len(tasks), 'run')} done", style="dim")

        run_tasks(_task, tasks, args.jobs, partial(_limit, args.limit), done)


def _compile(case):
    record_of(_problem(0, case))
    if case.number < _WARM_REFERENCES:
        referee(_problem(0, case), 0)


def _limit(seconds, task):
    return _REFERENCE_LIMIT if task[2] == "reference" else seconds


@lru_cache(maxsize=8)
def _problem(seed, case):
    return case.problem(seed)


def _task(task):
    """Make one result and store it (in a process of its own)."""
    seed, case, part, out = task
    problem = _problem(seed, case)
    if part == "reference":
        found = referee(problem, seed)
    elif part == "default":
        found = record_of(problem)
    else:
        base = _stored(out, seed, case, "default")
        if base is not None and base.end != "finished":
            found = Record("left out")
        else:
            found = record_of(related(problem, _relation(seed, case, part), seed, case.number))
    _save(out, seed, case, part, found)


def _relation(seed, case, part):
    """Name of the first or second relation of a case."""
    return chosen_relations(_problem(seed, case), seed, case.number)[_PARTS.index(part) - 2]


@cache
def _sources(part):
    """Digest of the code that a result depends on; references do not depend on all of the library."""
    here, library = Path(__file__).parent, Path(sphfilter.__file__).parent
    files = [
        here / f"{name}.py" for name in ("equations", "models", "sensors", "readers", "problems", "records")
    ]
    files += [library / "model" / "simulate.py", library / "core" / "sde_steps.py"]
    if part == "reference":
        files += [here / "referees.py", *sorted(Path(reference_filters.__file__).parent.glob("*.py"))]
    else:
        files += [here / "relations.py", *sorted(library.rglob("*.py"))]
    return digest_of(files)


def _stored(out, seed, case, part):
    kind = Referee if part == "reference" else Record
    return load(_file(out, seed, case, part), kind, _sources(part))


def _save(out, seed, case, part, result):
    save(_file(out, seed, case, part), result, _sources(part))


def _file(out, seed, case, part):
    """Where a result is; references are the same whatever the filter."""
    return path_of(out, RandomCase(case.number) if part == "reference" else case, seed, part)


def _judged(pair, out):
    """Case, seed, problem, record, reference and verdict of what is on disk."""
    seed, case = pair
    problem, (record, reference, *others) = _problem(*pair), (_stored(out, *pair, part) for part in _PARTS)
    names = (_relation(seed, case, part) for part in _PARTS[2:])
    verdict = judge(record, reference, dict(zip(names, others, strict=True)))
    return case, seed, problem, record, reference, verdict


def _tell(console, pair, out):
    """Print all that is known of a case, epoch by epoch, and how to have it in Python."""
    *_, problem, record, reference, verdict = judged = _judged(pair, out)
    for name, value in row_of(*judged).items():
        console.print(f"{name}: {value}", soft_wrap=True, markup=False)
    lines = [
        (f"{t:.6g}", *(f"{e:.2g}" for e in (*errors, record.error[k])), "yes" if record.flagged[k] else "")
        for k, (t, errors) in enumerate(zip(problem.times, verdict.errors.T, strict=False))
    ]
    headings = "t", *(f"{name} error" for name in LIMITS), "info.error", "flag"
    console.print(shown.table(f"epochs against {reference.name or 'nothing'}", headings, lines))
    again = f"problem = {pair[1]}.problem({pair[0]}); record = record_of(problem)"
    console.print(f"In Python: {again} (experiments.stress.random.problems, .records)", soft_wrap=True)
