"""One ICCP iteration and a whole ICCP: geomag beside what a Python user would write with contourpy and a KD-tree.

The peer is given every advantage that keeps it ICCP: its contour lines are cut and indexed once, outside the clock, where
it says `cached`; the segment under the nearest vertex is not looked for. Both answers are asserted to be the same.
"""

from __future__ import annotations

import argparse
import time

import contourpy
import numpy as np
from scipy.spatial import KDTree

import geomag

SPACING = 250.0


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
        near = np.array([t.data[t.query(p)[1]] for t, p in zip(self.trees, points, strict=True)])
        p, q = points - points.mean(axis=0), near - near.mean(axis=0)
        angle = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum())
        c, s = np.cos(angle), np.sin(angle)
        return p @ np.array([[c, s], [-s, c]]) + near.mean(axis=0)


def best_of(work, repeat):
    """Least seconds of several runs, and the last answer."""
    least = np.inf
    for _ in range(repeat):
        start = time.perf_counter()
        answer = work()
        least = min(least, time.perf_counter() - start)
    return least, answer


def rows(smoke: bool = False) -> list[dict[str, object]]:
    """Run the comparison; one row a task."""
    axis, values, _, indicated, v = scene(200 if smoke else 800)
    grid = geomag.GridMap(values, axis, axis)
    track = geomag.Track(indicated[:, 0], indicated[:, 1], v)
    peer = Peer(axis, values, v)
    repeat = 2 if smoke else 5
    cut, _ = best_of(peer.index, 1 if smoke else 3)
    cached, moved = best_of(lambda: peer.iteration(indicated), 10 * repeat)

    def ours(iterations):
        return geomag.match_contour(grid, track, max_iterations=iterations)

    one, fix = best_of(lambda: ours(1), 200 * repeat)
    # The peer's points lie on lines cut every 25 m: half of that is how far the two may differ.
    assert np.abs(fix.track - moved).max() < 15, np.abs(fix.track - moved).max()
    few, _ = best_of(lambda: ours(40), 20 * repeat)
    iterations = ours(40).iterations
    # Marginal cost of an iteration, without what a call costs once.
    marginal = (few - one) / max(1, iterations - 1)

    def peer_whole():
        points = indicated
        for _ in range(iterations):
            points = peer.iteration(points)
        return points

    peer_few, end = best_of(peer_whole, 2)
    assert np.abs(ours(40).track - end).max() < 60
    name = "contourpy + KD-tree"
    return [
        {"task": "one ICCP iteration, 22 points", "geomag_s": one, "peer": f"{name}, cached", "peer_s": cached},
        {
            "task": "one ICCP iteration, 22 points, contours cut anew",
            "geomag_s": one,
            "peer": name,
            "peer_s": cut + cached,
        },
        {
            "task": "each further iteration",
            "geomag_s": marginal,
            "peer": f"{name}, cached",
            "peer_s": peer_few / iterations,
        },
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true")
    for row in rows(parser.parse_args().smoke):
        ratio = row["peer_s"] / row["geomag_s"]
        print(
            f"{row['task']:52} geomag {1e6 * row['geomag_s']:10.1f} us   {row['peer']:28} "
            f"{1e6 * row['peer_s']:12.1f} us   ratio {ratio:8.1f}"
        )


if __name__ == "__main__":
    main()
