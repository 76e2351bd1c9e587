"""Many seeded trials: how often a matcher finds the truth, how far off it is, how often it is wrong unsaid.

A trial is a flight of `geomag.synthetic` and a match of it. Everything random in trial i follows from the campaign's
seed and i alone: any subset, order, number of threads or workers gives the same rows. On one machine the trials of
geomag's own matchers run in Rust on all cores; beyond it, on any `concurrent.futures` executor or Dask client.

>>> from geomag import campaign, synthetic
>>> grid = synthetic.Crust().draw((0, 0, 60_000, 60_000), seed=1).grid(500.0, units="nT")
>>> plan = campaign.Campaign(
...     grid,
...     tracks=campaign.RandomTracks(samples=30, spacing_m=(500.0, 1000.0)),
...     ins=synthetic.InsSpread(synthetic.Uniform((3000.0, 3000.0))),
...     sensor=synthetic.Sensor(sigma=1.0),
...     seed=7,
... )
>>> table = plan.run(campaign.grid_search("msd", half_width=3500.0, sigma=2.0), trials=200)
>>> len(table), table.summary(tolerance_m=500.0).wrong
(200, 0)
"""

from __future__ import annotations

from geomag.campaign._methods import Keyed, Method, contour, grid_search, iema, posterior
from geomag.campaign._methods import Matcher as Matcher
from geomag.campaign._plan import MOST_TRIALS as MOST_TRIALS
from geomag.campaign._plan import Campaign, RandomTracks
from geomag.campaign._table import Summary, Table

__all__ = ["Campaign", "Keyed", "Method", "RandomTracks", "Summary", "Table", "contour", "grid_search", "iema",
           "posterior"]  # fmt: skip
