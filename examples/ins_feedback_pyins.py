"""Fixes fed back to an INS that pyins simulates: geomag's own filter, and pyins' full one, on the same fixes.

Needs pyins (extra `ins`). Run: python examples/ins_feedback_pyins.py
"""

import numpy as np
import pandas as pd
from pyins import filters, inertial_sensor, measurements, sim, strapdown

import geomag

HOURS = 4
STEP_S = 60
SIGMA_NT = 2.0
# The Schuler oscillation bends the track, and a fix of one offset, turn and stretch does not know: by its own covariance its
# squared errors are three times too large here (6 a fix instead of 2). The filter is told so.
BENDING = 3.0
rng = np.random.default_rng(5)

# A ship at 10 m/s for four hours, and the IMU that it carries: 0.01 deg/h and 30 micro-g of bias.
truth, imu = sim.generate_sine_velocity_motion(1.0, HOURS * 3600.0, [34.2, 15.3, 0.0], [7.0, 7.0, 0.0], 1.0, 3000.0)
gyro = inertial_sensor.Parameters(bias=np.radians(0.01) / 3600 * rng.normal(size=3))
accel = inertial_sensor.Parameters(bias=30e-6 * 9.8 * rng.normal(size=3))
increments = strapdown.compute_increments_from_imu(
    inertial_sensor.apply_imu_parameters(imu, "rate", gyro, accel), "rate"
)
error = sim.generate_pva_error(500.0, 0.3, 0.003, 0.05, rng=3)
start = sim.perturb_pva(truth.iloc[0], error)
ins = strapdown.Integrator(start, with_altitude=False).integrate(increments)

# The field along the way: a map at a hundredth of a degree, read where the ship truly is.
lon, lat = np.arange(15.0, 17.6, 0.01), np.arange(33.9, 35.6, 0.01)
field = 90 * np.sin(48 * lon)[None, :] * np.cos(57 * lat)[:, None] + 50 * np.cos(31 * lon[None, :] - 77 * lat[:, None])
grid = geomag.GridMap(field, lon, lat, geographic=True, units="nT")
times = np.arange(0, HOURS * 3600, STEP_S)
true = truth.loc[times, ["lon", "lat"]].to_numpy()
shown = ins.loc[times, ["lon", "lat"]].to_numpy()
readings = grid.sample(true[:, 0], true[:, 1], interpolation="bicubic") + SIGMA_NT * rng.normal(size=len(times))


def metres(a, b):
    """Distance between two positions in degrees."""
    east, north = grid.metres_per_unit(float(b[1]))
    return float(np.hypot((a[0] - b[0]) * east, (a[1] - b[1]) * north))


feedback = geomag.InsFeedback(
    position_sigma_m=500.0, velocity_sigma_m_s=0.5, heading_sigma_deg=0.15, position_walk_m_sqrt_s=0.3,
    velocity_walk_m_s_sqrt_s=0.02, velocity_time_constant_s=5000.0, geographic=True,
)  # fmt: skip
corrected, fixes, squares = [], [], []
for k, t in enumerate(times):
    fix = None
    # Every quarter of an hour the last 20 minutes are matched, about where the filter believes the ship to be.
    if k >= 20 and k % 15 == 0:
        window = slice(k - 19, k + 1)
        state, spread = feedback.state, feedback.covariance
        east, north = grid.metres_per_unit(float(shown[k, 1]))
        believed = shown[window] + state[:2] / (east, north)
        sigma = float(np.sqrt(max(spread[0, 0], spread[1, 1]))) + 200.0
        # The Schuler oscillation bends the track, which no offset, turn or stretch can follow: sigma is doubled for it.
        fix = geomag.match_contour(
            grid, geomag.Track(believed[:, 0], believed[:, 1], readings[window]), transform="translation",
            starts="grid", refine=True, sigma=2 * SIGMA_NT, offset_sigma_m=sigma, heading_sigma_deg=1.0, scale_sigma=0.03,
        )  # fmt: skip
    widened = BENDING * fix.covariance_m2 if fix is not None and fix.ok else None
    step = feedback.step(float(t), *shown[k], fix, covariance_m2=widened)
    corrected.append((step.after.x, step.after.y))
    if step.accepted:
        sd = float(np.sqrt(np.trace(widened) / 2))
        fixes.append((float(t), fix.y, fix.x, sd))
        off = (true[k] - (fix.x, fix.y)) * grid.metres_per_unit(float(true[k, 1]))
        squares.append(float(off @ np.linalg.solve(widened, off)))
        print(
            f"{t / 3600:4.1f} h: INS {metres(shown[k], true[k]):6.0f} m off, fix {metres((fix.x, fix.y), true[k]):5.0f} m "
            f"off and believed to {sd:4.0f} m, corrected {metres(corrected[-1], true[k]):5.0f} m off"
        )

late = times >= 3600
ours = np.array([metres(c, t) for c, t in zip(corrected, true, strict=True)])
alone = np.array([metres(c, t) for c, t in zip(shown, true, strict=True)])
print(
    f"after the first hour: INS alone {np.median(alone[late]):.0f} m, with feedback {np.median(ours[late]):.0f} m (median)"
)

print(f"squared errors of the fixes over their widened variances: {np.mean(squares):.1f} (2 is right)")

# The same fixes as position measurements of pyins' own filter.
table = pd.DataFrame([f[1:3] for f in fixes], index=[f[0] for f in fixes], columns=["lat", "lon"]).assign(alt=0.0)
full = filters.run_feedback_filter(
    start, 500.0, 0.3, 0.003, 0.05, increments,
    gyro_model=inertial_sensor.EstimationModel(bias_sd=np.radians(0.01) / 3600),
    accel_model=inertial_sensor.EstimationModel(bias_sd=30e-6 * 9.8),
    measurements=[measurements.Position(table, float(np.median([f[3] for f in fixes])))],
    time_step=20.0, with_altitude=False,
)  # fmt: skip
theirs = full.trajectory.loc[times, ["lon", "lat"]].to_numpy()
away = np.array([metres(c, t) for c, t in zip(theirs, true, strict=True)])
print(f"the same fixes in pyins' error-state filter: {np.median(away[late]):.0f} m")
assert np.mean(squares) < 4.0
assert np.median(ours[late]) < 0.5 * np.median(alone[late])
