"""A progress bar for whoever waits: on a terminal, or in a notebook."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

__all__ = ["progress_bar", "solve_text", "terminal_display"]


@contextmanager
def progress_bar(wanted: bool = True) -> Iterator[Callable[..., None]]:
    """Yield a function `show(text, fraction=None)`, which shows a text and a bar until the block ends.

    `fraction` is the finished part of the work, 0 to 1; None if it is unknown. In a notebook, the bar is an output of
    the cell; otherwise it is written to standard error. Nothing is shown if that is not a terminal, or not `wanted`.
    """
    shell = sys.modules["IPython"].get_ipython() if sys.modules.get("IPython") else None
    if wanted and hasattr(shell, "kernel"):
        from IPython.display import DisplayHandle

        handle = DisplayHandle()
        handle.display({"text/plain": ""}, raw=True)

        def show(text: str, fraction: float | None = None) -> None:
            value = "" if fraction is None else f' value="{fraction:.3f}"'
            html = f"<progress{value}></progress> {escape(text)}"
            handle.update({"text/plain": text, "text/html": html}, raw=True)

        try:
            yield show
        finally:
            handle.update({"text/plain": "", "text/html": ""}, raw=True)
    elif wanted and sys.stderr.isatty():
        from rich.console import Console

        with terminal_display(Console(stderr=True)) as display:
            task = display.add_task("", total=None)
            yield lambda text, fraction=None: display.update(
                task, description=text, total=None if fraction is None else 1.0, completed=fraction or 0.0
            )
    else:
        yield lambda *_: None


def solve_text(sweeps: float, residual: float, threshold: float) -> str:
    """Return the text of a solve that ends when its residual is below a threshold."""
    return f"solving: {sweeps:.1f} sweeps, residual {residual:.3g}, ends below {threshold:.3g}"


def terminal_display(console: Console) -> Progress:
    """Return a display of rich with a text, a bar and the elapsed time, which disappears when it stops."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True, redirect_stdout=False)
