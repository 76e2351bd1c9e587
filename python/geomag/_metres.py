"""Metres per map unit where no map is at hand."""

from __future__ import annotations

from functools import cache

import numpy as np

from geomag._geomag import GridMap


@cache
def _probe(geographic: bool) -> GridMap:
    return GridMap(np.zeros((2, 2)), [0.0, 1.0], [-1.0, 1.0], geographic=geographic)


def metres_per_unit(geographic: bool, y: float) -> tuple[float, float]:
    """Metres per map unit (east, north) at a y: what `GridMap.metres_per_unit` says of any map of that kind."""
    return _probe(geographic).metres_per_unit(y)
