"""What ``python -m experiments --help`` teaches: what to try first, and commands by what one wants."""

__all__ = ["examples", "overview"]

_RUN = "python -m experiments"

#: Headings; commands below each, with two lines to try and what they do.
_GROUPS = {
    "Look around": {
        "list": (("list", "what there is to run"), ("list --help", "every command has its --help")),
        "run": (
            ("run duffing", "simulate, filter, tell, draw"),
            ("run van_der_pol --runs 25 --jobs 2", "a table of the paper, two processes"),
        ),
    },
    "Your own measurements and systems": {
        "filter": (
            ("filter --model my.toml --data my.csv", "see filter --help for both files"),
            ("filter --model my.toml --data my.csv --filters sph,pf", "only some of the filters"),
        ),
        "transient": (
            ("transient duffing", "beside a reference, with pictures"),
            ("transient --config my.toml --animate film.gif", "a system of your own, as a film"),
        ),
    },
    "Beyond the state": {
        "estimate": (
            ("estimate duffing --compare", "parameters by evidence, a rival"),
            ("estimate duffing --parameters xi,R --guess xi=0.5", "others; R is the sensor's noise"),
            ("estimate sunspots --jobs 2", "of the measured numbers; ten minutes"),
        ),
    },
    "Compare filters": {
        "campaign": (
            ("campaign duffing --runs 200 --jobs 2 --own-prior", "which filter can be believed?"),
            (
                "campaign van_der_pol --runs 50 --filters ekf,sph",
                "some of them",
            ),
            ("campaign cart --runs 1000 --dask tcp://10.0.0.5:8786", "on many machines"),
        ),
        "sweep": (
            ("sweep duffing", "over update interval and noise"),
            ("sweep duffing --interval 1,2 --q 1 --runs 10", "a smaller grid"),
        ),
        "benchmark": (
            ("benchmark duffing --quick", "does it work? in a minute"),
            ("benchmark van_der_pol --filters sph,pf,ukf", "some of the filters"),
        ),
        "realtime": (
            ("realtime duffing --budgets 10,20", "with 10 and 20 ms for a step"),
            ("realtime --runs 5", "four scenarios, four budgets"),
        ),
        "switching": (
            ("switching course", "a target that turns now and then"),
            ("switching turns --runs 5", "four states, all modes linear"),
        ),
    },
    "Check the solver": {
        "converge": (
            ("converge", "the filter against the Kalman filter"),
            ("converge van_der_pol --over scheme", "a density, by every scheme"),
            ("converge cubic,Laplace --sensors", "the error as nodes double"),
        ),
        "stress": (
            ("stress --quick", "a reduced grid"),
            ("stress --list", "names of the cells, for --only"),
            ("stress --random 50 --seed 3", "random problems instead"),
        ),
        "skips": (
            ("skips --samples 5", "all of them, quickly"),
            ("skips --only 'no measurement'", "those with these words in their name"),
        ),
        "scaling": (
            ("scaling --counts 500,1000", "few particles, all schemes"),
            ("scaling van_der_pol --schemes log_density", "one scheme"),
        ),
    },
}
_WIDE = 80  # columns of a terminal; longer lines have what they do below


def examples(command):
    """Lines to try of one command; empty for one that has none here."""
    found = [lines for group in _GROUPS.values() for name, lines in group.items() if name == command]
    return "Examples:\n" + _block(found[0]) if found else ""


def overview(summaries):
    """The end of the help: what to try first, and all commands in groups.

    Parameters
    ----------
    summaries : dict of str to str
        A line on each command, by name. Those that no group has come last.
    """
    parts = [f"Try first:\n  {_RUN} run duffing  # half a minute; the first time more"]
    for heading, group in _GROUPS.items():
        parts.append(f"{heading}\n" + "\n".join(_entry(n, summaries[n], lines) for n, lines in group.items()))
    known = {name for group in _GROUPS.values() for name in group}
    rest = [_entry(name, text, ()) for name, text in summaries.items() if name not in known]
    if rest:
        parts.append("More\n" + "\n".join(rest))
    parts.append(
        "Results go to the folder results. Ctrl-C keeps what is finished: the same\ncommand goes on."
    )
    return "\n\n".join(parts)


def _entry(name, summary, lines):
    return f"  {name:<11}{summary}" + ("\n" + _block(lines, "    ") if lines else "")


def _block(lines, indent="  "):
    """One example a line, and what it does as a comment: beside it, or below a long one."""
    beside = [f"{indent}{_RUN} {line}  # {does}" for line, does in lines]
    below = [f"{indent}{_RUN} {line}\n{indent}    # {does}" for line, does in lines]
    return "\n".join(a if len(a) <= _WIDE else b for a, b in zip(beside, below, strict=True))
