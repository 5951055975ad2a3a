"""Heat maps of a sweep."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm, Normalize

__all__ = ["draw"]

_AXES = {"interval": "interval between updates (s)", "q": "factor on Q", "r": "factor on R"}


def draw(out, rows, name):
    """Draw one picture of the runs lost and one of the RMS ratios, a panel a filter.

    Parameters
    ----------
    out : Path
        Folder, which exists.
    rows : list of dict
        As `sweep` makes them.
    name : str
        Scenario, for the titles.

    Returns
    -------
    list of Path
    """
    ratios = [row["rms_ratio"] for row in rows if np.isfinite(row["rms_ratio"])]
    pictures = [("lost", "part of the runs lost", Normalize(0.0, 1.0), "Reds")]
    if ratios:
        # at least a factor of 1.5 either way, so that sampling error does not look like a finding
        span = max(1.5, *ratios, *(1 / ratio for ratio in ratios))
        pictures.append(("rms_ratio", "RMS error / RMS error of the PF", LogNorm(1 / span, span), "RdBu_r"))
    return [_draw(out / f"{key}.png", rows, key, f"{name}: {label}", (norm, colors))
            for key, label, norm, colors in pictures]  # fmt: skip


def _draw(path, rows, key, title, colouring):
    """Draw one panel a filter (across) and a value of the third axis (down)."""
    x, y, panel = sorted(_AXES, key=lambda axis: len({row[axis] for row in rows}) == 1)
    names = list(dict.fromkeys(row["filter"] for row in rows))
    third = sorted({row[panel] for row in rows})
    xs, ys = (sorted({row[axis] for row in rows}) for axis in (x, y))
    size = (1.6 + len(names) * (0.6 + 0.55 * len(xs)), 1.4 + len(third) * (0.8 + 0.45 * len(ys)))
    fig, panels = plt.subplots(len(third), len(names), figsize=size, squeeze=False, sharex=True, sharey=True,
                               layout="constrained")  # fmt: skip
    for i, value in enumerate(third):
        for ax, name in zip(panels[i], names, strict=True):
            cells = {
                (row[x], row[y]): row[key] for row in rows if row["filter"] == name and row[panel] == value
            }
            image = _panel(ax, np.array([[cells[a, b] for a in xs] for b in ys]), *colouring)
            ax.set_title(
                name.upper() if len(third) == 1 else f"{name.upper()}, {_AXES[panel]} {value:g}", size=9
            )
            ax.set_xticks(range(len(xs)), [f"{v:g}" for v in xs])
            ax.set_yticks(range(len(ys)), [f"{v:g}" for v in ys])
    fig.supxlabel(_AXES[x], size=9)
    fig.supylabel(_AXES[y], size=9)
    fig.suptitle(title, size=10)
    fig.colorbar(image, ax=panels, shrink=0.9)
    fig.savefig(path, dpi=130)
    plt.close(fig)
    return path


def _panel(ax, values, norm, colors):
    """Colour the cells and write their numbers on them."""
    image = ax.imshow(values, norm=norm, cmap=colors, origin="lower", aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        red, green, blue, _ = image.cmap(norm(value))
        dark = 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", size=7, color="white" if dark else "black")
    return image
