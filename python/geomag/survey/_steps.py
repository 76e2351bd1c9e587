"""Progress of a computation of several steps, each of which may tell how far it is."""

from __future__ import annotations

from collections.abc import Callable

from geomag._progress import reporter

Progress = bool | Callable[[int, int], None] | None

#: Parts that one unit of work is told in.
PARTS = 100


class Steps:
    """Tells `progress` how much of `total` units of work is done, from the first moment on."""

    def __init__(self, progress: Progress, total: float) -> None:
        self._report = reporter(progress)
        self._done, self._total = 0.0, total
        self.tell(0.0)

    def tell(self, more: float) -> None:
        """Report what is done and `more` units."""
        done = min(self._done + more, self._total)
        self._report(round(PARTS * done), round(PARTS * self._total))

    def within(self, units: float) -> Callable[[int, int], None]:
        """Progress of a step of so many units."""
        return lambda done, total: self.tell(units * done / max(total, 1))

    def add(self, units: float) -> None:
        """Report a step as done."""
        self._done = min(self._done + units, self._total)
        self.tell(0.0)
