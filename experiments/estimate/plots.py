"""Pictures of profile log-evidences."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from experiments.show.style import COLOURS, frame, legend_below, panels, save

_OURS = COLOURS["sph"]


def draw_profiles(path, fit, profiles, truth, title):
    """Draw the profile of each parameter with the parabola of its standard error.

    Profiles are values (K,) and log-evidences (K,) by name; the `truth` is marked where known.
    """
    columns = min(3, len(profiles))
    rows = -(-len(profiles) // columns)
    size = (3.6 * columns + 0.6, 2.9 * rows + 0.7)
    figure, axes = panels(rows, columns, size, len(profiles), sharey=True)
    for ax, (name, (values, evidence)) in zip(axes.flat, profiles.items(), strict=False):
        best, error = fit.estimate[name], fit.standard_error[name]
        x = np.linspace(values.min(), values.max(), 200)
        if np.isfinite(error):
            ax.plot(x, -0.5 * ((x - best) / error) ** 2, color="0.55", lw=1.2, ls="--", label="parabola")
            ax.axvspan(best - error, best + error, color=_OURS, alpha=0.13, lw=0)
        below = evidence - fit.log_evidence
        known = np.isfinite(below)
        ax.plot(x, PchipInterpolator(values[known], below[known], extrapolate=False)(x), color=_OURS, lw=1.4)
        ax.plot(values[known], below[known], "o", color=_OURS, ms=4.5, label="profile")
        ax.axvline(best, color=_OURS, lw=0.8)
        if name in truth:
            ax.axvline(truth[name], color="0.1", lw=1.2, ls=":", label="truth")
        ax.axhline(-1.92, color="0.75", lw=0.8, zorder=0)  # half of chi square's 95 % point
        frame(ax, f"{name} = {best:.4g} ± {error:.2g}", name, "")
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[:, 0]:
        ax.set_ylabel("below the maximum (nat)")
        ax.set_ylim(-5.0, 0.4)
    legend_below(figure, axes[0, 0], columns=3)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    save(figure, path)
