"""Cases put through filters and referees, in processes of their own; what is finished is kept on disk."""

from dataclasses import replace
from functools import lru_cache, partial

from experiments.arguments.stress import AUTO
from experiments.show.tables import counted
from experiments.terminal.progress import bar, resumable
from experiments.terminal.running import status

from .pool import Lost, run_tasks
from .records import FILTERS, Record, record_of
from .referees import SIZES, Referee, referee
from .relations import chosen_relations, related
from .store import REFERENCE, load, save
from .verdicts import judge

#: Seconds a reference may take, and seconds that compiling may take on an empty cache.
_REFERENCE_LIMIT, _COMPILE_LIMIT = 240.0, 1800.0
#: Between the name of a filter and the number of a relation, in the name of a part of a case.
_RELATION = " relation "
#: Examples whose references are made to compile what these need, and particles in their clouds.
_EXAMPLES, _EXAMPLE_SIZES = 4, (1000, 1000)


def walk(console, cases, filters, args):
    """Make what is not yet on disk: records of filters, references, records of related problems."""
    tasks = [
        (case, part, str(args.out))
        for case in cases
        for part in (*filters, REFERENCE, *(one for name in filters for one in _relations(case, name)))
        if load(args.out, case, part) is None
    ]
    if tasks:
        _warm_up(console, cases[0].examples(), [*filters, REFERENCE])
    kept, count = f"finished runs are kept in {args.out}. The same command goes on from there.", 0
    with bar(console, "runs", len(tasks), left=True) as move, resumable(lambda: kept):

        def done(task, result):
            nonlocal count
            count += 1
            case, part, out = task
            if isinstance(result, Lost):
                save(out, case, part, _lost(part, result))
            move(count, text=f"{case.name} {part}")
            if not console.is_terminal and (count % 10 == 0 or count == len(tasks)):
                console.print(f"{count} of {counted(len(tasks), 'run')} done", style="dim")

        run_tasks(_task, tasks, args.jobs, partial(_limit, args.limit), done)


def judged(case, name, out):
    """Problem, record, reference and verdict of a case and a filter, from what is on disk."""
    problem, record, reference = problem_of(case, name), load(out, case, name), load(out, case, REFERENCE)
    chosen = chosen_relations(problem, case)
    partners = (load(out, case, part) for part in _relations(case, name))
    verdict = judge(record, reference, dict(zip(chosen, partners, strict=True)), problem.truth)
    return problem, record, reference, verdict


def _relations(case, name):
    """Parts of a case that are records of a filter on related problems."""
    return [f"{name}{_RELATION}{k + 1}" for k in range(case.n_relations)]


def _warm_up(console, examples, parts):
    """Let all compile what they need, in another process, so that compiling does not count as run time."""
    with status(console) as say:
        say(f"preparing {' and '.join(parts)} (the first time compiles, for minutes)")
        tasks = [(examples, part) for part in parts]
        run_tasks(_compile, tasks, 1, lambda task: _COMPILE_LIMIT, lambda task, _: say(f"{task[1]} is ready"))


def _compile(task):
    examples, part = task
    for case in examples[:_EXAMPLES] if part == REFERENCE else examples:
        _made(case, part, "", _EXAMPLE_SIZES)


def _limit(seconds, task):
    case, part, _ = task
    return _REFERENCE_LIMIT if part == REFERENCE else case.patience * seconds


def _lost(part, lost):
    if part == REFERENCE:
        return Referee(why=lost.sentence)
    return Record("timeout" if lost.timeout else "crash", lost.sentence)


@lru_cache(maxsize=8)
def _problem(case):
    return case.problem()


def problem_of(case, name):
    """The problem of a case, as a filter is given it."""
    return replace(_problem(case), n_particles="auto") if name.startswith(AUTO) else _problem(case)


def _task(task):
    """Make one part of a case and store it (in a process of its own)."""
    case, part, out = task
    save(out, case, part, _made(case, part, out))


def _made(case, part, out, sizes=SIZES):
    """A part of a case; the clouds of a reference have one of two numbers of particles."""
    if part == REFERENCE:
        return referee(_problem(case), case.seed, sizes)
    name, _, number = part.partition(_RELATION)
    problem, make = problem_of(case, name), partial(FILTERS[name], seed=case.seed)
    if not number:
        return record_of(problem, make)
    base = load(out, case, name)
    if base is not None and base.end != "finished":
        return Record("left out")
    relation = chosen_relations(problem, case)[int(number) - 1]
    return record_of(related(problem, relation, case.key), make)
