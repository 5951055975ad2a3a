"""A table of words and numbers as text for a terminal, Markdown, LaTeX, or HTML."""

import html
import math
from collections.abc import Iterable, Mapping, Sequence

_LATEX = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "~": r"\textasciitilde{}",
    "^": r"\^{}",
    "\\": r"\textbackslash{}",
}


def cells_of(rows: Iterable[tuple[str, Mapping[str, float]]]) -> list[list[str]]:
    """A list of a label and numbers for each row; without those that are known of nobody."""
    known = [(label, [*values.values()]) for label, values in rows]
    return [
        [label, *("-" if math.isnan(value) else f"{value:.4g}" for value in values)]
        for label, values in known
        if not all(map(math.isnan, values))
    ]


def in_text(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines with columns as wide as their cells."""
    first, *widths = (max(map(len, column)) for column in zip(heading, *rows, strict=True))
    wide = "".join(f"  {{:>{max(width, 12)}}}" for width in widths)
    return [f"{label:{first}}" + wide.format(*cells) for label, *cells in (heading, *rows)]


def in_markdown(heading: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> list[str]:
    """Lines of a pipe table, whose first columns stand to the left."""
    rule = ["---" if k < left else "---:" for k in range(len(heading))]
    said = ([cell.replace("|", "\\|") for cell in row] for row in (heading, rule, *rows))
    return [f"| {' | '.join(row)} |" for row in said]


def in_latex(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A tabular environment, of the package booktabs."""
    said = [" & ".join("".join(_LATEX.get(c, c) for c in cell) for cell in row) for row in (heading, *rows)]
    first, *rest = (f"{line} \\\\" for line in said)
    begin = f"\\begin{{tabular}}{{l{'r' * (len(heading) - 1)}}}"
    return "\n".join([begin, "\\toprule", first, "\\midrule", *rest, "\\bottomrule", "\\end{tabular}"])


def in_html(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table element."""

    def line(tag: str, row: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"

    return "\n".join(["<table>", line("th", heading), *(line("td", row) for row in rows), "</table>"])
