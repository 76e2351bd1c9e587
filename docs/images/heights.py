"""Makes heights.png of docs/guide/heights.md: `python docs/images/heights.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

import geomag
from geomag import continuation

mpl.use("Agg")
import matplotlib.pyplot as plt

rng = np.random.default_rng(4)
waves = [
    (rng.normal(0, 14), 2 * np.pi / length, rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi))
    for length in np.geomspace(500, 9000, 60)
]


def field(x: np.ndarray, y: np.ndarray, height: float | np.ndarray) -> np.ndarray:
    """Waves that fall as exp(-k h)."""
    return sum(a * np.exp(-k * height) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)


axis = np.arange(0.0, 20_001.0, 100.0)
grid = geomag.GridMap(field(axis, axis[:, None], 80.0), axis, axis, sigma=2.0, height_m=80.0)
up = grid.continue_to(380.0)
n = 60
x, y, height = np.linspace(4000, 13_000, n), np.linspace(6000, 11_000, n), np.linspace(130.0, 480.0, n)
readings = field(x, y, height) + 12 + rng.normal(0, 0.5, n)

figure, axes = plt.subplots(2, 2, figsize=(9, 7.4), constrained_layout=True)
span = float(np.abs(grid.values).max())
for ax, shown, title in ((axes[0, 0], grid, "the map, 80 m"), (axes[0, 1], up, "300 m above it")):
    image = ax.pcolormesh(axis / 1e3, axis / 1e3, shown.values, cmap="RdBu_r", vmin=-span, vmax=span)
    ax.plot(x / 1e3, y / 1e3, "k-", lw=1)
    ax.set(title=title, aspect="equal", xlabel="east, km", ylabel="north, km")
    figure.colorbar(image, ax=ax, label="nT")
image = axes[1, 0].pcolormesh(axis / 1e3, axis / 1e3, up.sigma, cmap="viridis", vmax=float(np.quantile(up.sigma, 0.98)))
axes[1, 0].set(title="sigma there (2 nT in the map)", aspect="equal", xlabel="east, km", ylabel="north, km")
figure.colorbar(image, ax=axes[1, 0], label="nT")
stack = grid.continue_to(continuation.levels(grid, 80.0, 500.0))
along = np.hypot(x - x[0], y - y[0]) / 1e3
axes[1, 1].plot(along, readings - readings.mean(), "k.", ms=4, label="readings of a climb from 130 to 480 m")
told = stack.sample(x, y, height)
axes[1, 1].plot(along, told - told.mean(), label="map, heights told")
flat = grid.sample(x, y)
axes[1, 1].plot(along, flat - flat.mean(), "--", label="map, not told")
axes[1, 1].set(xlabel="along the track, km", ylabel="nT")
axes[1, 1].legend(fontsize=8)
figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)
