"""Grids over survey lines: where their nodes lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import geomag
from geomag.survey import ErrorModel, Lines, _Axes, _nodes, map_from_lines

coordinate = st.floats(-1e7, 1e7, allow_subnormal=False)


@settings(deadline=None)
@given(coordinate, st.floats(0, 1e4), st.floats(1e-3, 1e3))
@example(0.9, 0.9, 1.0)
@example(0.3, 0.3, 0.1)
@example(-0.7, 1.4, 0.1)
def test_nodes_enclose_every_datum_and_no_more_than_that(low, extent, step):
    c = np.array([low + extent, low])
    first, count = _nodes(c, step)
    last = first + step * (count - 1)
    assert first <= c.min()
    assert last >= c.max()
    slack = 1e-6 * step + 4 * np.spacing(abs(c).max())
    assert c.min() - first <= step + slack
    assert last - c.max() <= step + slack or count == 2
    assert count <= int(extent / step) + 3


def test_a_map_of_lines_has_a_value_at_every_datum():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0.9, 11.8, 60), np.linspace(0.6, 9.5, 12)))
    lines = Lines(x, y, np.sin(x / 3) + np.cos(y / 2), np.repeat(np.arange(12), 60))
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.15, 0.8, 0, 0.0)
    grid = map_from_lines(lines, spacing=1.0, model=model)
    assert (grid.x[-1], grid.y[-1]) == (12.0, 10.0)
    assert np.isfinite(grid.sample(x, y)).all()


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf, (1.0, 2.0, 3.0), "wide", (1.0, 0.0)])
def test_a_spacing_that_is_none_is_refused(spacing):
    lines = Lines([0.0, 1, 2, 3], [0.0, 1, 0, 1], [1.0, 2, 3, 4], [0, 0, 1, 1])
    with pytest.raises(geomag.InvalidInputError, match="spacing"):
        _Axes.over(lines, spacing)
