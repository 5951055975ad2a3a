"""Progress bars, and what an interruption of long work says is kept."""

from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class Interrupted(KeyboardInterrupt):
    """The user stopped long work; the message says how to go on."""


@contextmanager
def bar(console, text, total=None, left=False):
    """Show a bar behind a text while something runs, and take it away in the end.

    The `total` is how much there is to do, if it is known already; with `left` the time that is left is
    shown, too. Yields a function move(done, total=None, text=None, found=False), which moves the bar, with
    another text behind it; what was `found` done took no time.
    """
    columns = [TextColumn(text), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    columns += [TextColumn("left"), TimeRemainingColumn()] if left else []
    with Progress(*columns, TextColumn("{task.description}"), console=console, transient=True) as shown:
        task = shown.add_task("", total=total)

        def move(done, total=None, text=None, found=False):
            if found:
                shown.reset(task)
            shown.update(task, completed=done, total=total, description=text)

        yield move


@contextmanager
def resumable(kept):
    """Turn Ctrl-C into `Interrupted`, whose message is "Stopped; " and what the function `kept` returns."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"Stopped; {kept()}") from None
