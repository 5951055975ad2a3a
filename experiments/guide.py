"""What `--help` teaches: what to try first, commands by what one wants, the end of the help of each."""

import re
from importlib.util import find_spec
from pathlib import Path

_RUN = "python -m experiments"
#: Headings, and the commands below each.
_GROUPS = {
    "Look around": ("list", "run"),
    "Your own measurements and systems": ("filter", "transient"),
    "Beyond the state": ("estimate",),
    "Compare filters": ("campaign", "sweep", "benchmark", "realtime", "switching"),
    "Check the solver": ("converge", "stress", "skips", "scaling"),
}
_WIDE = 80  # columns of a terminal; longer lines have what they do below


def end_of_help(command):
    """The text that the help of a command ends with: lines to try, and what there is to say besides."""
    path = Path(__file__).parent / "arguments" / f"{command}.txt"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return text + _formats() if command == "filter" else text


def _formats():
    """What the library says of the files that users keep; it is not imported for that."""
    library = Path(find_spec("sphfilter").origin).parent
    return (library / "files" / "formats.txt").read_text(encoding="utf-8")


def overview(summaries):
    """The end of the help: what to try first, and all commands in groups.

    The summaries are a line on each command, by name. Those that no group has come last.
    """
    known = {name for group in _GROUPS.values() for name in group}
    rest = [name for name in summaries if name not in known]
    parts = [f"Try first:\n  {_RUN} run duffing  # half a minute; the first time more"]
    for heading, group in (_GROUPS | ({"More": rest} if rest else {})).items():
        parts.append("\n".join([heading, *(_entry(name, summaries[name]) for name in group)]))
    parts.append(
        "Results go to the folder results. Ctrl-C keeps what is finished: the same\ncommand goes on."
    )
    return "\n\n".join(parts)


def _entry(name, summary):
    """A command, and below it its examples: each with what it does beside it, or below a long one."""
    lines = [f"  {name:<11}{summary}"]
    for line, does in re.findall(rf"^  {_RUN} (.+?)\s+# (.+)$", end_of_help(name), re.MULTILINE):
        example = f"    {_RUN} {line}"
        beside = f"{example}  # {does}"
        lines.append(beside if len(beside) <= _WIDE else f"{example}\n        # {does}")
    return "\n".join(lines)
