"""What is behind `progress`: the caller's own function, or the bar of `progress=True`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable


def bar(label: str = "") -> Callable[[int, int], None]:
    """Return a callable `(done, total)` that draws a bar with the time to go on standard error.

    Nothing is drawn where standard error is not a terminal.
    """
    start = time.monotonic()
    shown = False

    def show(done: int, total: int) -> None:
        nonlocal shown
        if total <= 0 or not sys.stderr.isatty():
            return
        share = min(done / total, 1.0)
        elapsed = time.monotonic() - start
        # At the start, and while the first share is small, nobody knows how long it takes.
        left = f"{_spell(elapsed / share - elapsed)} to go" if share > 0 and elapsed > 0.5 else ""
        filled = round(share * 30)
        end = "\n" if done >= total else ""
        if end and not shown:
            return  # finished before anything was worth drawing
        shown = True
        sys.stderr.write(f"\r{label}[{'#' * filled}{'.' * (30 - filled)}] {share:6.1%}  {left:<14}{end}")
        sys.stderr.flush()

    return show


def _spell(seconds: float) -> str:
    """A time to wait, with the digits that mean something."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def reporter(progress: bool | Callable[[int, int], object] | None) -> Callable[[int, int], object]:
    """Return what `progress` asks for: the caller's own, a bar, or nothing."""
    if callable(progress):
        return progress
    return bar() if progress else lambda done, total: None
