"""The heat map of the hard cases: a panel a filter, a row a family and system, a square a level."""

from collections import Counter

from matplotlib.patches import FancyBboxPatch, Patch

from experiments.show.style import plt, save

#: Distinct for the colour-blind too, and what is wrong without a word darkest: face and ink of each verdict.
_COLOURS = {
    "right": ("#8ecfb4", "#0b3d2e"),
    "right, flagged": ("#cfe8dc", "#0b3d2e"),
    "wrong, flagged": ("#f0a35e", "#4a2300"),
    "refused": ("#f6d98b", "#5a4300"),
    "no answer": ("#fbf0cf", "#5a4300"),
    "no reference": ("#dfe3e8", "#4a5560"),
    "crash": ("#8a94c8", "white"),
    "wrong, silent": ("#c0392b", "white"),
}
_SAID = {"crash": "crash, or stopped after the time limit"}
_NAMES = {"default": "SPH, given particles", "auto": "SPH, default", "auto.03": "SPH, target .03",
          "paper": "SPH, as published", "pf1e3": "particle filter, 1,000",
          "pf1e4": "particle filter, 10,000"}  # fmt: skip
_INK, _FAINT = "#1f2a33", "#4a5560"
#: Inches: width and height of a square, what stands left of the panels and above, the gap between panels.
_WIDE, _HIGH, _LEFT, _TOP, _GAP = 0.44, 0.25, 3.6, 0.85, 0.3
#: Least width of a panel, for its heading, and of a picture, for its legend of two lines.
_PANEL, _NARROWEST = 2.1, 6.4


def draw(path, rows):
    """Draw the verdicts into a file.

    Parameters
    ----------
    path : Path
    rows : list of dict
        As `tables.row_of` makes them, of hard cases.

    Returns
    -------
    Path
    """
    filters, lines = dict.fromkeys(row["filter"] for row in rows), {}
    for row in rows:
        levels = lines.setdefault((row["family"], row["system"], row["unit"]), {})
        levels.setdefault(row["level"], len(levels))
    panel = max(max(map(len, lines.values())) * _WIDE, _PANEL) + _GAP
    width, height = max(_LEFT + len(filters) * panel, _NARROWEST), _TOP + len(lines) * _HIGH + 0.6
    figure = plt.figure(figsize=(width, height))
    ax = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    ax.axis("off")
    ax.text(0.15, 0.36, "Where the filters hold", size=15, weight="bold", color=_INK)
    _names(ax, lines, width)
    for i, name in enumerate(filters):
        _panel(ax, [row for row in rows if row["filter"] == name], lines, _LEFT + i * panel)
    handles = [Patch(fc=face, label=_SAID.get(v, v)) for v, (face, _) in _COLOURS.items()]
    place = {"loc": "center", "bbox_to_anchor": (0.5 * width, height - 0.3), "bbox_transform": ax.transData}
    ax.legend(handles=handles, ncols=4, frameon=False, fontsize=6.8, handlelength=1.1, **place)
    return save(figure, path, dpi=150)


def _names(ax, lines, width):
    """Families at the left, once each, with a hairline above; systems beside them with the unit of levels."""
    before = None
    for j, (family, system, unit) in enumerate(lines):
        y = _TOP + (j + 0.5) * _HIGH
        if family != before:
            ax.plot([0.15, width - 0.15], 2 * [y - 0.5 * _HIGH], color="#c8ced4", lw=0.6, zorder=0)
            ax.text(0.15, y, family, va="center", size=8, weight="bold", color=_INK)
            before = family
        ax.text(_LEFT - 0.12, y, f"{system} · {unit}", va="center", ha="right", size=7, color=_FAINT)


def _panel(ax, rows, lines, x0):
    """Name of a filter and how often it is right and wrong, above its squares."""
    counts = Counter(row["verdict"] for row in rows)
    right, silent = counts["right"] + counts["right, flagged"], counts["wrong, silent"]
    ax.text(x0 + 0.03, _TOP - 0.26, _NAMES[rows[0]["filter"]], size=9.5, weight="bold", color=_INK)
    told = f"right {right} of {len(rows)}, " + (
        f"silently wrong {silent}" if silent else "never silently wrong"
    )
    ax.text(x0 + 0.03, _TOP - 0.09, told, size=7.5, color="#c0392b" if silent else "#2c7a5b")
    order = list(lines)
    for row in rows:
        line = row["family"], row["system"], row["unit"]
        _square(ax, row, x0 + lines[line][row["level"]] * _WIDE, _TOP + order.index(line) * _HIGH)


def _square(ax, row, x, y):
    face, ink = _COLOURS[row["verdict"]]
    box = {"fc": face, "ec": "none", "boxstyle": "round,pad=0,rounding_size=0.035"}
    ax.add_patch(FancyBboxPatch((x + 0.025, y + 0.025), _WIDE - 0.05, _HIGH - 0.05, **box))
    level = row["level"].replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")  # 1e-06: 1e-6
    ax.text(x + 0.5 * _WIDE, y + 0.5 * _HIGH, level, ha="center", va="center", size=6, color=ink)
