"""Heat maps of a sweep."""

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from experiments.scene.filters import name_of
from experiments.show.style import panels, save

_AXES = {"interval": "interval between updates (s)", "q": "factor on Q", "r": "factor on R"}


def draw(out, rows, name):
    """Draw a picture of the runs lost and one of the RMS ratios, a panel a filter; their paths.

    The rows are those of `tables.rows_of`; `name` is the scenario's, for the titles.
    """
    lost = _draw(
        out / "lost.png", rows, "lost", f"{name}: part of the runs lost", (Normalize(0.0, 1.0), "Reds")
    )
    # the particle filter itself, and filters that always failed, have nothing to compare
    telling = {row["filter"] for row in rows if np.isfinite(row["rms_ratio"]) and row["rms_ratio"] != 1.0}
    compared = [row for row in rows if row["filter"] in telling]
    if not compared:
        return [lost]
    ratios = [row["rms_ratio"] for row in compared if np.isfinite(row["rms_ratio"])]
    # at least a factor of 1.5 either way, so that sampling error does not look like a finding
    span = max(1.5, *ratios, *(1 / ratio for ratio in ratios))
    colouring = LogNorm(1 / span, span), "RdBu_r"
    title = f"{name}: RMS error / RMS error of the PF"
    return [lost, _draw(out / "rms_ratio.png", compared, "rms_ratio", title, colouring)]


def _draw(path, rows, key, title, colouring):
    """Draw one panel a filter (across) and a value of the third axis (down)."""
    x, y, panel = sorted(_AXES, key=lambda axis: len({row[axis] for row in rows}) == 1)
    names = list(dict.fromkeys(row["filter"] for row in rows))
    xs, ys, third = (sorted({row[axis] for row in rows}) for axis in (x, y, panel))
    size = (2.2 + len(names) * (0.3 + 0.5 * len(xs)), 1.4 + len(third) * (0.5 + 0.45 * len(ys)))
    figure, axes = panels(len(third), len(names), size, sharex=True, sharey=True)
    for row, value in zip(axes, third, strict=True):
        for ax, name in zip(row, names, strict=True):
            here = [row for row in rows if row["filter"] == name and row[panel] == value]
            cells = {(row[x], row[y]): row[key] for row in here}
            image = _panel(ax, np.array([[cells[a, b] for a in xs] for b in ys]), *colouring)
            where = f", {panel.upper()} × {value:g}" if len(third) > 1 else ""
            ax.set_title(name_of(name) + where, size=9)
            ax.set_xticks(range(len(xs)), [f"{v:g}" for v in xs])
            ax.set_yticks(range(len(ys)), [f"{v:g}" for v in ys])
    figure.supxlabel(_AXES[x], size=9)
    figure.supylabel(_AXES[y], size=9)
    figure.suptitle(title, size=10)
    _colour_bar(figure, image, axes)
    return save(figure, path)


def _panel(ax, values, norm, colors):
    """Colour the cells and write their numbers on them."""
    image = ax.imshow(values, norm=norm, cmap=colors, origin="lower", aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        known = np.isfinite(value)
        red, green, blue, _ = image.cmap(norm(value)) if known else (1.0, 1.0, 1.0, 1.0)
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        text = f"{value:.2f}" if known else "–"
        ax.text(j, i, text, ha="center", va="center", size=7, color="white" if dark else "black")
    return image


def _colour_bar(figure, image, axes):
    bar = figure.colorbar(image, ax=axes, shrink=0.9)
    if isinstance(image.norm, LogNorm):
        ticks = np.geomspace(image.norm.vmin, image.norm.vmax, 5)
        bar.set_ticks(ticks, labels=[f"{v:.2f}" for v in ticks])
        bar.minorticks_off()
