"""Which samples to match: delta modulation, the sampling rules, and tuning them for a planned track.

Run: python examples/sequence.py
"""

import numpy as np

import geomag

axis = 250.0 * np.arange(280)
field = 170 * np.sin(axis / 5200)[None, :] * np.cos(axis / 6100)[:, None]
grid = geomag.GridMap(field, axis, axis, units="nT")
k = np.arange(150.0)
x, y = 9000 + 230 * k, 8000 + 160 * k
planned = geomag.Track(x, y, grid.sample(x, y))

keep = geomag.delta_modulation(planned.values, 8.0)
print(f"delta modulation, 8 nT: {len(keep)} of {len(planned)} samples, first codes {keep.codes[:12]}")

along = planned.distance_m()
chosen = geomag.choose_sequence(along, planned.values, quantum=8.0, cell_m=250.0)
print(
    f"with the sampling theorem and one a cell: {len(chosen['keep'])} samples, {len(chosen['filled'])} of them brought "
    f"back; gaps at most {chosen['greatest_gap_m'] / 1000:.1f} km"
)

options = {"sigma": 1.0, "offset_m": 790.0, "heading_sigma_deg": 0.5, "max_length": 20, "draws": 10}
best = geomag.tune_sequence(grid, planned, **options)
swarm = geomag.tune_sequence(grid, planned, method="bpso", **options)
for name, found in (("every setting", best), ("particle swarm", swarm)):
    print(
        f"{name:15} L {found['length']}, delta {found['quantum']:g} nT: objective {found['objective']:.3f}, error "
        f"{found['error_m']:.0f} m, {len(found['settings'])} settings evaluated"
    )
assert swarm["objective"] <= 1.05 * best["objective"]
