"""Densities on the move: films of them as files, and a window that shows them as they come."""

from contextlib import suppress

from matplotlib.animation import FFMpegWriter, PillowWriter

from experiments.show.style import plt
from sphfilter.errors import ConfigError

from .views import Views

_DPI = 90
_FPS = 10.0  # without a probe that says
#: Window systems, in the order in which they are tried.
TOOLKITS = ["QtAgg", "GTK4Agg", "GTK3Agg", "WxAgg", "TkAgg", "MacOSX"]


def animate(path, problem, densities):
    """Write densities as a film, a frame each; returns its path."""
    probe, views = problem.settings.probe, Views(problem)
    fps = _FPS if probe is None else probe.fps
    writer = (PillowWriter if path.suffix.lower() == ".gif" else FFMpegWriter)(fps=fps)
    views.expect(densities)
    figure = plt.figure(figsize=views.size, layout="constrained")
    with writer.saving(figure, path, dpi=_DPI):
        for density in densities:
            views.show(figure, density)
            writer.grab_frame()
    plt.close(figure)
    return path


class Window:
    """A window that shows densities as they come.

    Raises `ConfigError` if there is no display, or nothing that could open a window on it.
    """

    def __init__(self, problem):
        self.views = Views(problem)
        for toolkit in TOOLKITS:
            with suppress(ImportError):
                plt.switch_backend(toolkit)
                break
        else:
            raise ConfigError(
                "--live needs a display, and a toolkit that opens windows on it (PyQt6, PySide6, PyGObject, "
                "wxPython or tkinter), and found none: use --animate FILE.gif, which needs neither"
            )
        self.figure = plt.figure(problem.name, figsize=self.views.size, layout="constrained")

    @property
    def open(self):
        """Has nobody closed it?"""
        return plt.fignum_exists(self.figure.number)

    def __call__(self, number, density):
        """Show a density, whatever its number, if the window is still there."""
        if self.open:
            self.views.show(self.figure, density)
        if self.open:
            self.figure.canvas.manager.show()
            self.figure.canvas.draw()
            self.figure.canvas.flush_events()

    def wait(self):
        """Wait until somebody closes it."""
        if self.open:
            plt.show()
