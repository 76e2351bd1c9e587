"""What the IEMA experiments share: the paper's map, straight tracks, INS errors on and off the lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geomag._geomag import GridMap, Iema, IemaStep, Track
from geomag.io import read_grid
from geomag.reproduce import Context

MAP = "emm2017-crustal/emm2017_east_china_116_120E_31_35N_h0.nc"
HALF_WIDTH = (0.1, 0.1)
SPACING = 0.01


def load_map(context: Context, nodes: int) -> GridMap:
    """The south-western `nodes` x `nodes` of the region, total intensity (core and crust), nT."""
    grid = read_grid(context.file(MAP), "total_intensity_nt")
    return GridMap(
        np.asarray(grid.values, dtype=float)[:nodes, :nodes],
        grid.x[:nodes],
        grid.y[:nodes],
        geographic=True,
        name="total intensity",
        units="nT",
    )


@dataclass(frozen=True)
class Draw:
    """One straight track: truth (n, 2), true offset, readings."""

    truth: NDArray[np.float64]
    offset: NDArray[np.float64]
    readings: NDArray[np.float64]

    @property
    def indicated(self) -> NDArray[np.float64]:
        """What the INS shows."""
        return self.truth - self.offset

    def track(self, samples: int) -> Track:
        """The first samples as an indicated track."""
        x, y = self.indicated[:samples].T
        return Track(x, y, self.readings[:samples])

    def feed(self, iema: Iema, k: int) -> IemaStep:
        """Give sample `k` to a matcher."""
        x, y = self.indicated[k]
        return iema.update(float(x), float(y), float(self.readings[k]))


def draw(
    rng: np.random.Generator,
    grid: GridMap,
    samples: int,
    sigma: float,
    *,
    on_grid: bool,
    truth: NDArray[np.float64] | None = None,
) -> Draw:
    """Draw INS error and noise, and unless given a straight track of 1 to 3 cells a sample that stays on the map.

    An INS error on the grid is a whole multiple of the map spacing and the track's points are on nodes' multiples only
    by chance; off the grid it is uniform.
    """
    if truth is None:
        truth = straight(rng, grid, samples)
    cells = rng.integers(-10, 11, 2) * SPACING if on_grid else rng.uniform(-0.1, 0.1, 2)
    readings = np.asarray(grid.sample(truth[:, 0], truth[:, 1])) + rng.normal(0.0, sigma, len(truth))
    return Draw(truth, np.asarray(cells), readings)


def straight(rng: np.random.Generator, grid: GridMap, samples: int) -> NDArray[np.float64]:
    """A straight track with room for the search around it."""
    low = np.array([grid.x[0], grid.y[0]]) + 0.21
    high = np.array([grid.x[-1], grid.y[-1]]) - 0.21
    while True:
        course = rng.uniform(0, 2 * np.pi)
        step = rng.uniform(1.0, 3.0) * SPACING * np.array([np.sin(course), np.cos(course)])
        points = rng.uniform(low, high) + np.arange(samples)[:, None] * step
        if (points[-1] > low).all() and (points[-1] < high).all():
            return points


@dataclass(frozen=True)
class Outcome:
    """How one IEMA run ended: status, samples, error in cells (greater of the two axes; NaN without an offset)."""

    status: str
    samples: int
    error_cells: float


def run_iema(grid: GridMap, trial: Draw, sigma: float) -> Outcome:
    """Run the paper's rule to its end."""
    iema = Iema(grid, sigma=sigma, half_width=HALF_WIDTH)
    for k in range(len(trial.readings)):
        step = trial.feed(iema, k)
        if step.status != "searching":
            break
    error = np.abs(np.asarray(step.best_offset) - trial.offset).max() / SPACING
    return Outcome(step.status, step.n_samples, float(error))
