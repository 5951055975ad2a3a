"""`python -m experiments skips`: what each shortcut saves, and that results agree.

Every shortcut is run with and without on a scene that can use it. Times are processor time of one thread.
"""

from experiments.show.files import write_csv
from experiments.show.tables import markdown, print_table, table
from experiments.terminal.running import new_console, status
from sphfilter.errors import ConfigError

from .cases import cases
from .measure import lattice_against_box, measured

__all__ = ["main"]

_HEADS = ("shortcut", "scene", "with (ms)", "without (ms)", "ratio", "difference (std)")
_TITLES = {
    "skips": "processor time with each shortcut and without, and how far the results differ",
    "particles": "nodes of the lattice of a Gaussian, its states correlated by one half",
}
_LATTICES = ((1, 100), (2, 200), (3, 400), (4, 800))
_LATTICE_HEADS = ("states", "level set", "box, whitened", "box of the states")


def main(args):
    """Run the command; prints to standard output."""
    chosen = [case for case in cases() if args.only.lower() in f"{case.name} {case.scene}".lower()]
    if not chosen:
        raise ConfigError(f"no shortcut has {args.only!r} in its name: {', '.join(c.name for c in cases())}")
    console = new_console()
    with status(console) as say:
        rows = []
        for case in chosen:
            say(f"measuring {case.name}, {case.scene}")
            rows.append(_cells(measured(case, args.samples)))
        lattices = [tuple(map(str, (n, *lattice_against_box(n, N)))) for n, N in _LATTICES]
    text = []
    for name, heads, body, left in (("skips", _HEADS, rows, 2), ("particles", _LATTICE_HEADS, lattices, 0)):
        print_table(console, table(_TITLES[name], heads, body, left), keep=2)
        write_csv(args.out / f"{name}.csv", heads, body)
        text += [*markdown(heads, body, left), ""]
    (args.out / "skips.md").write_text("\n".join(text), encoding="utf-8")
    console.print(f"Tables: {args.out}/skips.md, skips.csv, particles.csv", soft_wrap=True)


def _cells(row):
    times = (f"{1e3 * row.on:.3g}", f"{1e3 * row.off:.3g}", f"{row.ratio:.2f}")
    return (row.name, row.scene, *times, f"{row.difference:.1e}")
