"""Chunks of trials on an executor or a Dask client, whose workers may die."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, wait
from dataclasses import dataclass
from typing import Any

from geomag._errors import GeomagError, InvalidInputError
from geomag._optional import require
from geomag.campaign._table import _Part

_Job = Callable[[Sequence[int], int | None], _Part]
"""Picklable: runs the trials that it is given, on so many threads."""


@dataclass(frozen=True)
class _Raised:
    """What the work itself raised in a worker: told apart from a worker's death, which another attempt may mend."""

    error: Exception


def _call(work: _Job, trials: Sequence[int], threads: int) -> _Part | _Raised:
    """Run in a worker."""
    try:
        return work(trials, threads)
    except Exception as error:
        error.add_note(f"in trials {trials[0]} to {trials[-1]} of a campaign:\n{traceback.format_exc()}")
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # an exception that does not travel: its words do
            return _Raised(GeomagError(f"campaign: trials {trials[0]} to {trials[-1]} failed ({error!r})"))
        return _Raised(error.with_traceback(None))


def _keep(work: _Job) -> _Job:
    """Hold the maps on a cluster as a task's result: unlike scattered data it is made anew when its worker dies."""
    return work


def _distribute(
    executor: object,
    work: _Job,
    chunks: Sequence[tuple[int, ...]],
    left: Sequence[int],
    *,
    threads: int,
    retries: int,
    finished: Callable[[int, _Part], None],
) -> None:
    """Give chunks out, take rows in; chunks that died with their worker are given out again."""
    on_dask = not isinstance(executor, Executor) and hasattr(executor, "get_executor")
    if not on_dask and not isinstance(executor, Executor):
        raise InvalidInputError(
            f"executor: needed a concurrent.futures.Executor or a distributed.Client, got {type(executor).__name__}"
        )
    pool: Any = executor
    payload: Any = pool.submit(_keep, work, pure=False) if on_dask else work
    options: dict[str, Any] = {"pure": False} if on_dask else {}

    def submit(i: int) -> Any:  # noqa: ANN401 - a future of either kind
        return pool.submit(_call, payload, chunks[i], threads, **options)

    attempts = dict.fromkeys(left, 0)
    waiting: dict[Any, int] = {submit(i): i for i in left}
    completed = _dask_completed(waiting) if on_dask else _completed(waiting)
    try:
        for future in completed:
            i = waiting.pop(future)
            try:
                part = future.result()
            except Exception as error:
                attempts[i] += 1
                if attempts[i] > retries:
                    raise GeomagError(
                        f"campaign: trials {chunks[i][0]} to {chunks[i][-1]} failed {attempts[i]} times ({error!r})"
                    ) from error
                try:
                    waiting[submit(i)] = i
                except RuntimeError as broken:
                    raise GeomagError(
                        f"campaign: the executor takes no more work ({broken}); finished chunks are kept where a folder "
                        "was given, and a new run with a new executor goes on from there"
                    ) from error
                continue
            if isinstance(part, _Raised):
                raise part.error
            finished(i, part)
    finally:
        for future in waiting:
            future.cancel()


def _completed(waiting: Mapping[Any, int]) -> Iterator[Any]:
    """Futures as they are done, those that are added meanwhile too; of several at once the first chunk's first, so that it is the first error that is told."""
    while waiting:
        yield from sorted(wait(waiting, return_when=FIRST_COMPLETED).done, key=waiting.__getitem__)


def _dask_completed(waiting: Mapping[Any, int]) -> Iterator[Any]:
    """`_completed` for the futures of a Dask client."""
    distributed = require("distributed", "distributed", "running on a Dask client")
    while waiting:
        yield from sorted(distributed.wait(list(waiting), return_when="FIRST_COMPLETED").done, key=waiting.__getitem__)
