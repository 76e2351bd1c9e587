"""What comes out: one row a trial, and what the rows come to."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geomag._errors import InvalidInputError
from geomag._optional import require
from geomag._statistics import binomial_interval

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

_Part = list[dict[str, "NDArray[Any]"]]


@dataclass(frozen=True)
class Summary:
    """What a table of trials comes to. Errors are of the fixes declared, metres."""

    trials: int
    fixed: int
    wrong: int
    """Fixes whose error is beyond the tolerance."""
    tolerance_m: float
    fix_rate: float
    wrong_rate: float
    """Wrong fixes over fixes; NaN without a fix."""
    wrong_rate_interval: tuple[float, float]
    """Its exact 95 % binomial interval."""
    median_m: float
    """Median error: the circular error probable (CEP)."""
    drms_m: float
    """Root mean square error (DRMS)."""
    error_95_m: float
    """95 % of the fixes are better."""
    samples_median: float
    samples_99: float
    ins_median_m: float
    """Median error of the INS at the same samples."""
    nees: float
    """Mean normalised error squared of fixes with a covariance: 2 where it is honest; NaN where there is none."""
    statuses: Mapping[str, int]
    """Count of every status."""

    def __str__(self) -> str:
        low, high = self.wrong_rate_interval
        return (
            f"{self.fixed} of {self.trials} fixed ({self.fix_rate:.1%}), {self.wrong} wrong by over "
            f"{self.tolerance_m:g} m ({self.wrong_rate:.2%} of fixes, 95 % interval {low:.2%} to {high:.2%}); "
            f"error median {self.median_m:.1f} m, DRMS {self.drms_m:.1f} m, 95 % {self.error_95_m:.1f} m; "
            f"samples median {self.samples_median:.0f}, 99 % {self.samples_99:.0f}"
        )


class Table:
    """One row a trial, in the order of the trials: a mapping from column names to arrays.

    Columns: `trial, status, n_samples, iterations, true_x, true_y` (map units), `error_m, error_east_m, error_north_m`
    (fix minus truth), `ins_error_east_m, ins_error_north_m` (indicated minus truth), `risk, goodness,
    covariance_ee_m2, covariance_en_m2, covariance_nn_m2, score, runner_up`; NaN where a method gives none.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        order = np.argsort(columns["trial"], kind="stable")
        self.columns: dict[str, NDArray[Any]] = {name: np.asarray(values)[order] for name, values in columns.items()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self.columns[name]
        except KeyError:
            raise InvalidInputError(f"column: needed one of {', '.join(self.columns)}, got {name!r}") from None

    def __len__(self) -> int:
        return int(self.columns["trial"].size)

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def equals(self, other: Table) -> bool:
        """Whether every bit of every column is the same (NaN equals NaN)."""
        return list(self) == list(other) and all(
            self[c].dtype == other[c].dtype and self[c].tobytes() == other[c].tobytes() for c in self
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return the table as a pandas data frame with the trial as its index."""
        pandas = require("pandas", "io", "campaign tables as data frames")
        return cast("pd.DataFrame", pandas.DataFrame(self.columns).set_index("trial"))

    def summary(self, tolerance_m: float) -> Summary:
        """Summarise: fix rate, wrong fixes beyond `tolerance_m` with their interval, errors, samples needed."""
        if not tolerance_m > 0:
            raise InvalidInputError(f"tolerance_m: needed a number > 0, got {tolerance_m}")
        ok = self["status"] == "fixed"
        errors = self["error_m"][ok]
        fixed, wrong = int(ok.sum()), int((errors > tolerance_m).sum())
        none = fixed == 0

        def percentile(values: NDArray[Any], q: float) -> float:
            return float(np.percentile(values, q)) if values.size else math.nan

        names, counts = np.unique(self["status"], return_counts=True)
        return Summary(
            trials=len(self),
            fixed=fixed,
            wrong=wrong,
            tolerance_m=float(tolerance_m),
            fix_rate=fixed / len(self) if len(self) else math.nan,
            wrong_rate=math.nan if none else wrong / fixed,
            wrong_rate_interval=binomial_interval(wrong, fixed),
            median_m=percentile(errors, 50),
            drms_m=math.nan if none else float(np.sqrt(np.mean(errors**2))),
            error_95_m=percentile(errors, 95),
            samples_median=percentile(self["n_samples"][ok], 50),
            samples_99=percentile(self["n_samples"][ok], 99),
            ins_median_m=percentile(np.hypot(self["ins_error_east_m"], self["ins_error_north_m"]), 50),
            nees=self._nees(ok),
            statuses={str(n): int(c) for n, c in zip(names, counts, strict=True)},
        )

    def _nees(self, ok: NDArray[np.bool_]) -> float:
        e, n = self["error_east_m"][ok], self["error_north_m"][ok]
        ee, en, nn = (self[f"covariance_{c}_m2"][ok] for c in ("ee", "en", "nn"))
        determinant = ee * nn - en * en
        good = determinant > 0
        if not good.any():
            return math.nan
        squared = (nn * e * e - 2 * en * e * n + ee * n * n)[good] / determinant[good]
        return float(squared.mean())

    def __repr__(self) -> str:
        return f"Table({len(self)} trials, {int((self['status'] == 'fixed').sum())} fixed)"


def _join(parts: Sequence[Mapping[str, NDArray[Any]]]) -> Table:
    return Table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
