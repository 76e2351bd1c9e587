"""Fit a harmonic model to scattered components, continue it upwards, match a track on it, sail on it."""

import numpy as np

import geomag

rng = np.random.default_rng(7)
frame = geomag.LocalFrame(45.0, 7.0)

# Buried dipoles stand in for geology: a field that is curl- and divergence-free above the ground.
sources = np.stack([rng.uniform(-9e3, 9e3, 40), rng.uniform(-9e3, 9e3, 40), rng.uniform(1500, 3000, 40)], axis=-1)
moments = rng.normal(size=(40, 3)) * 4e11


def true_field(points: np.ndarray) -> np.ndarray:
    """Field of the dipoles in nT (moments in nT m^3), north, east, down."""
    away = points[:, None, :] - sources
    r = np.linalg.norm(away, axis=-1, keepdims=True)
    return np.sum(3 * away * np.sum(moments * away, axis=-1, keepdims=True) / r**5 - moments / r**3, axis=1)


points = np.stack([rng.uniform(-8e3, 8e3, 4000), rng.uniform(-8e3, 8e3, 4000), rng.uniform(-200, 0, 4000)], axis=-1)
measured = true_field(points) + rng.normal(size=points.shape)
model = geomag.RectangularHarmonicModel.fit(*points.T, measured, order=12, period_ratio=1.4, frame=frame)
print(model)

above = points - [0.0, 0.0, 1000.0]
error = model.field(*above.T) - true_field(above)
print(f"1 km above the data: error {np.sqrt(np.mean(error**2)):.2f} nT rms of {np.std(true_field(above)):.0f} nT")

field = model.to_map("down", down_m=-100.0)
east, north = np.linspace(-3e3, 3e3, 40), np.linspace(-2e3, 3e3, 40)
track = geomag.Track(east - 500, north + 300, field.sample(east, north) + rng.normal(size=40))
grid = field.to_grid(np.arange(-7e3, 7001.0, 50.0), np.arange(-7e3, 7001.0, 50.0))
print(geomag.match_grid(grid, track, half_width=(1500, 1500), step=50))

navigator = geomag.FieldNavigator(
    model, start=(60.0, -40.0), covariance_m2=1e4, reading_sigma=1.0, down_m=-100.0, position_noise_m2_s=0.1
)
truth = np.zeros(2)
for _ in range(600):
    truth += np.array([3.0, 2.0])
    reading = model.field(truth[1], truth[0], -100.0) + rng.normal(size=3)
    step = navigator.step(1.0, np.hypot(3.0, 2.0), np.degrees(np.arctan2(3.0, 2.0)), reading)
print(step, f"error {np.hypot(step.x - truth[0], step.y - truth[1]):.1f} m")
