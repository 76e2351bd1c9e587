"""Words that several calls take."""

from __future__ import annotations

from typing import Literal

#: Measures of the grid search.
Criterion = Literal["msd", "mad", "prod", "ncc", "hausdorff"]
