"""One ICCP iteration and a whole ICCP: geomag beside what a Python user would write with contourpy and a KD-tree.

The peer is given every advantage that keeps it ICCP: its contour lines are cut and indexed once, outside the clock, where
it says `cached`; the segment under the nearest vertex is not looked for. Both answers are asserted to be the same.
"""

from __future__ import annotations

import contourpy
import numpy as np
from scipy.spatial import KDTree

import geomag
from geomag.cli.bench import best_of

SPACING = 250.0
#: Contours are looked for within three standard deviations of the INS drift, as in the paper.
RADIUS = 2370.0


def field(x, y):
    """A smooth field of the roughness of the papers' first region."""
    return 180 * np.sin(x / 9000) * np.cos(y / 11_000) + 120 * np.cos((x + 2 * y) / 15_000) + 40 * np.sin(y / 5000)


def scene(nodes):
    """Map, truth and indicated track of 22 points, 790 m off."""
    axis = SPACING * np.arange(nodes)
    values = field(axis[None, :], axis[:, None])
    d = 840.0 * np.arange(22)
    centre = 0.3 * axis[-1]
    truth = np.column_stack([centre + 0.8 * d, centre + 0.6 * d])
    indicated = truth - (500.0, -611.6)
    return axis, values, truth, indicated, field(*truth.T)


def dense_lines(generator, level, step=25.0):
    """Points every `step` metres along the contour of a level."""
    out = []
    for line in generator.lines(level):
        d = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        at = np.arange(0, d[-1], step)
        out.append(np.column_stack([np.interp(at, d, line[:, 0]), np.interp(at, d, line[:, 1])]))
    return np.concatenate(out)


class Peer:
    """ICCP with contourpy's lines and scipy's KD-trees."""

    def __init__(self, axis, values, levels):
        self.generator = contourpy.contour_generator(axis, axis, values, name="serial")
        self.levels = levels
        self.trees = None

    def index(self):
        """Cut every contour and index it."""
        self.trees = [KDTree(dense_lines(self.generator, level)) for level in self.levels]

    def iteration(self, points):
        """Closest points and the rigid transform onto them."""
        found = [t.query(p, distance_upper_bound=RADIUS) for t, p in zip(self.trees, points, strict=True)]
        reached = np.array([np.isfinite(d) for d, _ in found])
        near = np.array([t.data[i] for t, (d, i) in zip(self.trees, found, strict=True) if np.isfinite(d)])
        centre = points[reached].mean(axis=0)
        p, q = points[reached] - centre, near - near.mean(axis=0)
        angle = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum())
        c, s = np.cos(angle), np.sin(angle)
        return (points - centre) @ np.array([[c, s], [-s, c]]) + near.mean(axis=0)


def table(smoke: bool = False):
    """Rows of the common table: case, what, seconds, nanoseconds a point and iteration, times as long as geomag."""
    axis, values, _, indicated, v = scene(200 if smoke else 800)
    grid = geomag.GridMap(values, axis, axis)
    track = geomag.Track(indicated[:, 0], indicated[:, 1], v)
    peer = Peer(axis, values, v)
    repeat = 2 if smoke else 5
    cut, _ = best_of(1 if smoke else 3, peer.index)
    cached, moved = best_of(10 * repeat, lambda: peer.iteration(indicated))

    def ours(iterations):
        return geomag.match_contour(grid, track, radius_m=RADIUS, max_iterations=iterations)

    one, fix = best_of(200 * repeat, lambda: ours(1))
    # The peer's points lie on lines cut every 25 m: half of that is how far the two may differ.
    assert np.abs(fix.track - moved).max() < 15, np.abs(fix.track - moved).max()
    many, fix = best_of(20 * repeat, lambda: ours(40))
    iterations = fix.iterations
    # What an iteration costs in a run, without what a call costs once.
    each = (many - one) / max(1, iterations - 1)

    def whole():
        points = indicated
        for _ in range(iterations):
            points = peer.iteration(points)
        return points

    peer_many, end = best_of(2, whole)
    assert np.abs(fix.track - end).max() < 60, np.abs(fix.track - end).max()
    points = len(indicated)
    for case, what, seconds, base, n in (
        ("ICCP, one call, 1 iteration", "geomag", one, one, 1),
        ("ICCP, one call, 1 iteration", "contourpy + KD-tree, cached", cached, one, 1),
        ("ICCP, one call, 1 iteration", "contourpy + KD-tree", cut + cached, one, 1),
        ("ICCP, an iteration of many", "geomag", each, each, 1),
        ("ICCP, an iteration of many", "contourpy + KD-tree, cached", peer_many / iterations, each, 1),
        ("ICCP, a whole match", "geomag", many, many, iterations),
        ("ICCP, a whole match", "contourpy + KD-tree", cut + peer_many, many, iterations),
    ):
        yield case, what, seconds, 1e9 * seconds / (points * n), seconds / base
