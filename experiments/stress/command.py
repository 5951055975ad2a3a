"""`python -m experiments stress`: hard or random cases, put through filters and judged."""

from experiments.arguments.stress import AUTO
from experiments.show import tables as shown
from experiments.terminal.running import new_console, status, tell

from . import picture, told
from .hard_cases import chosen
from .random_cases import RandomCase
from .referees import LIMITS
from .runs import judged, walk
from .tables import failures, row_of, sections, sentences, write


def main(args):
    """Run the command: print and write the tables, draw the grid, tell epoch by epoch what was named."""
    console, is_random = new_console(), bool(args.random or args.random_case)
    named = [RandomCase(seed, number) for seed, number in args.random_case]
    numbered = [RandomCase(args.seed, number) for number in range(args.random or 0)] + named
    cases = numbered if is_random else chosen(args.seed, args.only, args.quick)
    if args.list:
        for case in cases:
            console.print(str(case), soft_wrap=True, markup=False)
        return
    counts = f"{shown.counted(len(cases), 'case')}, {shown.counted(len(args.filters), 'filter')}"
    console.print(f"{counts}, at most {args.limit:g} s a run", style="dim")
    walk(console, cases, args.filters, args)
    path = args.out / ("random.csv" if is_random else "stress.csv")
    rows, found, flags = _judged(console, cases, args)
    telling = [("errors told over errors made", told.HEADINGS, told.lines(found))] if found else []
    telling += [("flags", told.FLAGS, told.flag_lines(flags))] if flags else []
    write(path, rows, telling, args)
    for title, headings, lines in [*sections(rows), *telling]:
        shown.print_table(console, shown.table(title, headings, lines))
    tell(console, sentences())
    for line in failures(rows):
        console.print(line, style="red", soft_wrap=True, markup=False)
    for case in named:
        for name in args.filters:
            _tell(console, case, name, args.out)
    drawings = [told.draw(args.out / f"{path.stem}_told.png", found)] if found else []
    drawings += [] if is_random else [picture.draw(path.with_suffix(".png"), rows)]
    pictures = "".join(f" Picture: {drawing}" for drawing in drawings)
    console.print(f"\nEvery case is in {path}, the rest in {path.stem}.md.{pictures}", soft_wrap=True)


def _judged(console, cases, args):
    """Judge what is on disk: a row a case and filter, and what those that choose told, made and flagged."""
    rows, found, flags = [], [], []
    with status(console) as say:
        say("judging")
        for case in cases:
            for name in args.filters:
                of_case = judged(case, name, args.out)
                rows.append(row_of(case, name, *of_case))
                found += told.told_of(*of_case) if name.startswith(AUTO) else []
                flags += [told.flags_of(*of_case[1:])] if name.startswith(AUTO) else []
    return rows, found, flags


def _tell(console, case, name, out):
    """Print all that is known of a case, epoch by epoch, and how to have it in Python."""
    problem, record, reference, verdict = found = judged(case, name, out)
    for key, value in row_of(case, name, *found).items():
        console.print(f"{key}: {value}", soft_wrap=True, markup=False)
    lines = [
        (f"{t:.6g}", *(f"{e:.2g}" for e in (*errors, record.told[0, k])), "yes" if record.flagged[k] else "")
        for k, (t, errors) in enumerate(zip(problem.times, verdict.errors.T, strict=False))
    ]
    headings = "t", *(f"{name} error" for name in LIMITS), "info.error", "flag"
    console.print(shown.table(f"epochs against {reference.name or 'nothing'}", headings, lines))
    again = f"problem = problem_of({case!r}, {name!r}); record = record_of(problem, FILTERS[{name!r}])"
    where = "(experiments.stress.random_cases, .runs, .records)"
    console.print(f"In Python: {again} {where}", soft_wrap=True, markup=False)
