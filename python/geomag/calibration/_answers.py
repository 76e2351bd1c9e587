"""Answers of a matcher on tracks whose truth is known: how they are summed up, written and drawn."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from geomag._statistics import MEDIAN_NEES, wilson
from geomag.survey import limit_of_mean
from geomag.survey._trials import NO_STATEMENT

Array = npt.NDArray[np.float64]

#: Bounds of the risk bins of a report.
RISK_BINS = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.5)
#: Those that are judged together: of risks below, so few tracks tell nothing.
TOGETHER = RISK_BINS[2:]
#: Limits of the risk at which reports say what is fixed.
LIMITS = (0.01, 0.02, 0.03, 0.05)
#: Risks are counted as at least this in the log loss.
LEAST_RISK = 1e-4


@dataclass(frozen=True)
class Calibration:
    """Answers of a matcher on tracks whose truth is known.

    Shapes (n,): `risk` declared, `error_m` of the newest position, `fixed` whether a fix was declared, `status`, `nees` the
    normalised error squared e^T P^-1 e (2 on average where the covariance is right), `samples` that the answer took.
    `independent` is the share of the tracks that have no sample in common: intervals are those of so many.
    """

    name: str
    tolerance_m: float
    max_risk: float
    risk: Array
    error_m: Array
    fixed: npt.NDArray[np.bool_]
    status: npt.NDArray[np.str_]
    nees: Array
    samples: npt.NDArray[np.int_]
    independent: float = 1.0

    def summary(self) -> dict[str, float]:
        """Fix rate, and of the fixes: share wrong, share beyond twice the tolerance, errors, mean declared risk, mean NEES."""
        ok = self.fixed
        error = self.error_m[ok]
        some = error.size > 0
        nan = float("nan")
        return {
            "tracks": float(ok.size),
            "fixed": float(ok.mean()),
            "wrong": float(np.mean(error > self.tolerance_m)) if some else nan,
            "gross": float(np.mean(error > 2 * self.tolerance_m)) if some else nan,
            "declared": float(self.risk[ok].mean()) if some else nan,
            "median_m": float(np.median(error)) if some else nan,
            "p95_m": float(np.quantile(error, 0.95)) if some else nan,
            "rms_m": float(np.sqrt(np.mean(error**2))) if some else nan,
            "nees": float(np.mean(self.nees[ok])) if some else nan,
            "nees_median_ratio": float(np.nanmedian(self.nees[ok])) / MEDIAN_NEES if some else nan,
            "log_loss": self.log_loss(),
            "samples_median": float(np.median(self.samples[ok])) if some else nan,
            "samples_p95": self.samples_for(0.95),
            "wrong_upper": one_sided_limit(float(np.sum(error > self.tolerance_m)), error.size, self.independent),
        }

    def log_loss(self) -> float:
        """Mean log loss of the declared risks (those of answers that state one), risks taken within [1e-4, 1 - 1e-4]."""
        stated = ~np.isin(self.status, NO_STATEMENT)
        if not stated.any():
            return float("nan")
        risk = np.clip(self.risk[stated], LEAST_RISK, 1 - LEAST_RISK)
        wrong = self.error_m[stated] > self.tolerance_m
        return float(np.mean(-np.log(np.where(wrong, risk, 1 - risk))))

    def shares(self, limits: tuple[float, ...] = LIMITS) -> list[dict[str, float]]:
        """One row a limit and rule: what would be fixed of all tracks, and what of that is wrong, with its 95 % Wilson interval.

        Rule `single`: the risk of each fix is within the limit (what `max_risk` does). Rule `mean`: the mean risk of what is declared is within it;
        `max_risk` is then the limit of the single risk that this comes to. For answers to whole tracks; a stream has stopped before.
        """
        stated = ~np.isin(self.status, NO_STATEMENT)
        rows = []
        for limit in limits:
            for rule, single in (("single", limit), ("mean", limit_of_mean(self.risk[stated], limit))):
                fixed = stated & (self.risk <= single)
                n, wrong = int(fixed.sum()), int(np.sum(self.error_m[fixed] > self.tolerance_m))
                below, above = wilson(wrong * self.independent, n * self.independent)
                rows.append(
                    {
                        "mean_rule": float(rule == "mean"),
                        "limit": limit,
                        "max_risk": single,
                        "fixed": n / fixed.size,
                        "n": n,
                        "wrong": wrong,
                        "observed": wrong / n if n else float("nan"),
                        "lower": below,
                        "upper": above,
                    }
                )
        return rows

    def samples_for(self, share: float) -> float:
        """Samples after which `share` of all tracks were fixed, infinite where they never were (streamed answers)."""
        needed = np.sort(np.where(self.fixed, self.samples, np.inf))
        return float(needed[min(int(np.ceil(share * needed.size)) - 1, needed.size - 1)])

    def _binned(self, bins: tuple[float, ...]) -> Iterator[tuple[float, float, npt.NDArray[np.bool_]]]:
        """Of every risk bin its bounds and the answers that state a risk within it."""
        stated = ~np.isin(self.status, NO_STATEMENT)
        for low, high in itertools.pairwise(bins):
            yield low, high, stated & (self.risk >= low) & (self.risk < high)

    def reliability(self, bins: tuple[float, ...] = RISK_BINS) -> list[dict[str, float]]:
        """One row a risk bin: tracks, mean declared risk, observed wrong share, its 95 % Wilson interval."""
        rows = []
        for low, high, inside in self._binned(bins):
            n = int(inside.sum())
            wrong = int(np.sum(self.error_m[inside] > self.tolerance_m))
            below, above = wilson(wrong * self.independent, n * self.independent)
            rows.append(
                {
                    "low": low,
                    "high": high,
                    "n": n,
                    "wrong": wrong,
                    "declared": float(self.risk[inside].mean()) if n else float("nan"),
                    "observed": wrong / n if n else float("nan"),
                    "lower": below,
                    "upper": above,
                }
            )
        return rows

    def together(self, bins: tuple[float, ...] = TOGETHER, draws: int = 2000, seed: int = 0) -> dict[str, float]:
        """Whether all bins at once agree with what was declared: of some bins one is outside its 95 % interval by chance.

        `chi_square` is the sum over the bins of (wrong - declared)^2 / sum of p (1 - p), times the share of the tracks that is independent; `p` how often
        outcomes drawn from the declared risks have as large a one; `all_inside` how often all bins of such outcomes are within their Wilson intervals; `bins`
        how many bins there are. Chi-square's own law does not hold where a bin expects less than some five wrong ones, which is why it is drawn.
        """
        rng = np.random.default_rng(seed)
        seen, drawn, inside, count = 0.0, np.zeros(draws), np.ones(draws, dtype=bool), 0
        for _, _, some in self._binned(bins):
            # As many tracks as are independent, spread over the bin's risks.
            risk = np.sort(self.risk[some])
            n = round(self.independent * risk.size)
            if n == 0:
                continue
            count += 1
            variance, expected = float(np.sum(risk * (1 - risk))), float(risk.sum())
            wrong = int(np.sum(self.error_m[some] > self.tolerance_m))
            seen += self.independent * (wrong - expected) ** 2 / variance
            risk = risk[np.floor((np.arange(n) + 0.5) * risk.size / n).astype(int)]
            totals = np.array([np.count_nonzero(rng.random(n) < risk) for _ in range(draws)])
            drawn += (totals - risk.sum()) ** 2 / np.sum(risk * (1 - risk))
            within = {k: wilson(k, n) for k in np.unique(totals)}
            inside &= [within[k][0] <= risk.mean() <= within[k][1] for k in totals]
        return {
            "chi_square": seen,
            "bins": float(count),
            "p": float(np.mean(drawn >= seen)),
            "all_inside": float(np.mean(inside)),
        }

    def to_markdown(self) -> str:
        """Summary and reliability as Markdown tables."""
        s = self.summary()
        lines = [
            f"### {self.name}",
            "",
            f"Tolerance {self.tolerance_m:g} m, fixes declared at risk up to {100 * self.max_risk:g} %."
            + (
                f" Tracks overlap: {self.independent * s['tracks']:.0f} are independent, and the intervals are theirs."
                if self.independent < 1
                else ""
            ),
            "",
            "| tracks | fixed | wrong | beyond twice the tolerance | mean declared | median error | 95 % | NEES, mean | median / 1.386 | log loss | samples |",
            "|---|---|---|---|---|---|---|---|---|---|---|",
            f"| {s['tracks']:.0f} | {100 * s['fixed']:.1f} % | {100 * s['wrong']:.2f} % | {100 * s['gross']:.2f} % | "
            f"{100 * s['declared']:.2f} % | {s['median_m']:.0f} m | {s['p95_m']:.0f} m | {s['nees']:.2f} | "
            f"{s['nees_median_ratio']:.2f} | {s['log_loss']:.3f} | "
            f"{s['samples_median']:.0f} |",
            "",
            "| declared risk | tracks | mean declared | wrong | observed | 95 % interval |",
            "|---|---|---|---|---|---|",
        ]
        for row in self.reliability():
            if row["n"] == 0:
                continue
            lines.append(
                f"| {100 * row['low']:g} to {100 * row['high']:g} % | {row['n']:.0f} | {100 * row['declared']:.2f} % | "
                f"{row['wrong']:.0f} | {100 * row['observed']:.2f} % | "
                f"{100 * row['lower']:.2f} to {100 * row['upper']:.2f} % |"
            )
        both = self.together()
        if both["bins"]:
            lines += [
                "",
                f"Bins from {100 * TOGETHER[0]:g} % up together: chi-square {both['chi_square']:.1f} of {both['bins']:.0f} bins, p = {both['p']:.2g}. Were every "
                f"declared risk right, all of them would be within their intervals {100 * both['all_inside']:.0f} times of a hundred.",
            ]
        lines += [
            "",
            "| limit | fixed: risk of each within it | wrong | 95 % interval | fixed: mean risk within it | wrong | 95 % interval | risk of each up to |",
            "|---|---|---|---|---|---|---|---|",
        ]
        rows = self.shares()
        for single, mean in zip(rows[::2], rows[1::2], strict=True):
            cells = [
                f"{100 * one['fixed']:.1f} % | {one['wrong']:.0f} | {100 * one['lower']:.2f} to {100 * one['upper']:.2f} %"
                for one in (single, mean)
            ]
            lines.append(f"| {100 * single['limit']:g} % | {cells[0]} | {cells[1]} | {100 * mean['max_risk']:.2g} % |")
        return "\n".join([*lines, ""])

    def plot(self, path: str | Path) -> None:
        """Draw the reliability diagram; needs matplotlib (extra `plot`)."""
        from geomag.plot import reliability_points, save

        rows = [r for r in self.reliability() if r["n"]]
        points = [(r["declared"], r["observed"], r["lower"], r["upper"], int(r["n"])) for r in rows]
        ax = reliability_points(points, label="observed, 95 %")
        ax.set_title(textwrap.fill(self.name, 45), fontsize=9)
        save(ax.figure, path)  # type: ignore[arg-type]


def one_sided_limit(wrong: float, n: int, independent: float = 1.0) -> float:
    """Upper 95 % limit of a binomial share (Wilson) of `n` trials of which `independent` is the share that counts."""
    return wilson(wrong * independent, n * independent, 1.645)[1]
