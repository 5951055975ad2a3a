"""The heat map of the stress grid: a panel a method, a row a family and system, a square a level."""

from matplotlib.patches import FancyBboxPatch, Patch

from experiments.show.style import plt, save

from .judge import VERDICTS

__all__ = ["draw"]

#: Distinct for the colour-blind too, and the bad ones dark: face and ink of each verdict.
_COLOURS = {
    "ok": ("#8ecfb4", "#0b3d2e"),
    "refused": ("#f6d98b", "#5a4300"),
    "no reference": ("#dfe3e8", "#4a5560"),
    "timeout": ("#8a94c8", "white"),
    "wrong": ("#c0392b", "white"),
}
_NAMES = {"default": "SPH, default", "paper": "SPH, as published", "pf1e3": "particle filter, 1,000",
          "pf1e4": "particle filter, 10,000"}  # fmt: skip
_CELL, _LEFT, _GAP = (0.44, 0.25), 3.6, 0.3
#: Least width of a panel, for its heading, and of a picture whose legend is one line; of all pictures.
_PANEL, _WIDE, _NARROWEST = 1.9, 9.5, 6.4


def draw(path, rows):
    """Draw the verdicts into a file.

    Parameters
    ----------
    path : Path
    rows : list of dict
        As `tables.row_of` makes them.

    Returns
    -------
    Path
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines = list(dict.fromkeys((row["family"], row["system"]) for row in rows))
    levels = {line: list(dict.fromkeys(r["level"] for r in rows if (r["family"], r["system"]) == line))
              for line in lines}  # fmt: skip
    units = {(row["family"], row["system"]): row["unit"] for row in rows}
    panel = max(max(map(len, levels.values())) * _CELL[0], _PANEL) + _GAP
    width = max(_LEFT + len(methods) * panel, _NARROWEST)
    height = len(lines) * _CELL[1] + (1.35 if width >= _WIDE else 1.6)
    figure = plt.figure(figsize=(width, height))
    ax = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    ax.axis("off")
    y0 = 0.85
    _names(ax, lines, units, y0, width)
    for i, method in enumerate(methods):
        x0 = _LEFT + i * panel
        here = [row for row in rows if row["method"] == method]
        _panel(ax, here, lines, levels, x0, y0)
        _heading(ax, method, here, x0, y0)
    ax.text(0.15, 0.36, "Where the filters hold", size=15, weight="bold", color="#1f2a33")
    _legend(ax, width, height)
    return save(figure, path, dpi=150)


def _names(ax, lines, units, y0, width):
    """Families at the left, once each, with a hairline above; systems beside them with the unit of levels."""
    before = None
    for j, (family, system) in enumerate(lines):
        y = y0 + (j + 0.5) * _CELL[1]
        if family != before:
            ax.plot([0.15, width - 0.15], 2 * [y - 0.5 * _CELL[1]], color="#c8ced4", lw=0.6, zorder=0)
            ax.text(0.15, y, family, va="center", size=8, weight="bold", color="#1f2a33")
            before = family
        unit = units[family, system]
        ax.text(_LEFT - 0.12, y, f"{system} · {unit}" if unit else system, va="center", ha="right", size=7,
                color="#4a5560")  # fmt: skip


def _panel(ax, rows, lines, levels, x0, y0):
    verdicts = {(row["family"], row["system"], row["level"]): row["verdict"] for row in rows}
    for j, line in enumerate(lines):
        for i, level in enumerate(levels[line]):
            verdict = verdicts.get((*line, level))
            if verdict is None:
                continue
            face, ink = _COLOURS[verdict]
            x, y = x0 + i * _CELL[0], y0 + j * _CELL[1]
            box = FancyBboxPatch((x + 0.025, y + 0.025), _CELL[0] - 0.05, _CELL[1] - 0.05, fc=face, ec="none",
                                 boxstyle="round,pad=0,rounding_size=0.035")  # fmt: skip
            ax.add_patch(box)
            ax.text(x + 0.5 * _CELL[0], y + 0.5 * _CELL[1], _short(level), ha="center", va="center", size=6,
                    color=ink)  # fmt: skip


def _short(level):
    """The number of a level, as short as it can be written: 1e-06 -> 1e-6."""
    return level.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def _heading(ax, method, rows, x0, y0):
    """Name of the method, and the share of cells that are ok."""
    n_ok = sum(row["verdict"] == "ok" for row in rows)
    n_wrong = sum(row["verdict"] == "wrong" for row in rows)
    ax.text(x0 + 0.03, y0 - 0.26, _NAMES.get(method, method), size=9.5, weight="bold", color="#1f2a33")
    told = f"ok {n_ok} of {len(rows)}, " + ("never wrong" if n_wrong == 0 else f"wrong {n_wrong}")
    ax.text(x0 + 0.03, y0 - 0.09, told, size=7.5, color="#c0392b" if n_wrong else "#2c7a5b")


def _legend(ax, width, height):
    """One line under everything, or two where the picture is narrow."""
    said = {"refused": "refused with a sentence", "no reference": "no reference to judge by",
            "timeout": "stopped after the time limit", "wrong": "wrong, or a crash"}  # fmt: skip
    handles = [Patch(fc=_COLOURS[v][0], label=said.get(v, v)) for v in VERDICTS]
    ax.legend(
        handles=handles,
        ncols=len(handles) if width >= _WIDE else 3,
        frameon=False,
        fontsize=6.8,
        handlelength=1.1,
        handleheight=1.1,
        columnspacing=1.2,
        loc="center",
        bbox_to_anchor=(0.5 * width, height - (0.2 if width >= _WIDE else 0.3)),
        bbox_transform=ax.transData,
    )
