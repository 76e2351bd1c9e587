"""Progress of a computation of several steps, each of which may tell how far it is, and steps done side by side."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import TypeVar

from geomag._progress import reporter

Progress = bool | Callable[[int, int], None] | None

#: Parts that one unit of work is told in.
PARTS = 100
#: Seconds between reports while others work.
REPORT_S = 0.1

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Stopped(BaseException):
    """Raised in a thread whose result nobody waits for any more."""


class Steps:
    """Tells `progress` how much of `total` units of work is done, from the first moment on.

    Steps may be told of by several threads; `progress` is called in the one that made this object alone.
    """

    def __init__(self, progress: Progress, total: float) -> None:
        self._report = reporter(progress)
        self._done, self._total = 0.0, total
        self._owner = threading.get_ident()
        self._lock = threading.Lock()
        self._stopped = False
        #: What is done of the step that a thread is at.
        self._under_way: dict[int, float] = {}
        self.tell(0.0)

    def tell(self, more: float) -> None:
        """Report what is done and `more` units of the step that this thread is at."""
        me = threading.get_ident()
        with self._lock:
            self._under_way[me] = more
        if me == self._owner:
            self.report()
        elif self._stopped:
            raise Stopped

    def report(self) -> None:
        """Report what all threads have done."""
        with self._lock:
            done = min(self._done + sum(self._under_way.values()), self._total)
        self._report(round(PARTS * done), round(PARTS * self._total))

    def within(self, units: float) -> Callable[[int, int], None]:
        """Progress of a step of so many units."""
        return lambda done, total: self.tell(units * done / max(total, 1))

    def waited_for(self, done: int, total: int) -> None:
        """Raise `Stopped` in a thread whose result nobody waits for any more."""
        if self._stopped:
            raise Stopped

    def add(self, units: float) -> None:
        """Report a step of this thread as done."""
        with self._lock:
            self._done = min(self._done + units, self._total)
            self._under_way.pop(threading.get_ident(), None)
        self.tell(0.0)

    def side_by_side(self, work: Callable[[_Item], _Result], items: Sequence[_Item]) -> list[_Result]:
        """`work` of every item, in their order, by as many threads as there are cores: for work that leaves the interpreter.

        The first error is raised once the other threads have come to their next report, and so is an interruption.
        """
        if len(items) < 2 or cores() < 2 or threading.get_ident() != self._owner:
            return [work(item) for item in items]
        with ThreadPoolExecutor(min(len(items), cores())) as threads:
            waiting = [threads.submit(work, item) for item in items]
            try:
                while True:
                    done, left = wait(waiting, REPORT_S, FIRST_EXCEPTION)
                    if not left or any(one.exception() is not None for one in done):
                        return [one.result() for one in waiting if one.done()]
                    self.report()
            except BaseException:
                self._stopped = True
                for one in waiting:
                    one.cancel()
                raise


def cores() -> int:
    """Threads that work side by side: one a core that this process may use, or what RAYON_NUM_THREADS says, as in the compiled parts."""
    told = os.environ.get("RAYON_NUM_THREADS", "")
    if told.isdecimal() and int(told) > 0:
        return int(told)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
