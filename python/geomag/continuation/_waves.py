"""Maps in wave numbers: holes filled, edges gone over, spectra."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError

Array = npt.NDArray[np.float64]

#: Power of the wave number by which the power of crustal fields falls in the plane (Maus and Dimri 1994, doi 10.1029/94GL00771)
#: and its least share of the greatest, steps in which it foretells the field beyond edges, a third of them on planes of more
#: waves, and how close is close enough.
FALL, LEAST, STEPS, LARGE, CLOSE = 3.0, 1e-9, 30, 4_000_000, 1e-3


def filled(values: Array) -> Array:
    """Holes filled by a smooth surface that meets what is known: Laplace's equation, from coarse grids to fine ones."""
    unknown = ~np.isfinite(values)
    if not unknown.any():
        return values
    if min(values.shape) >= 8:
        sums = np.where(unknown, 0.0, values)
        rows, columns = values.shape
        even = np.pad(sums, ((0, rows % 2), (0, columns % 2)))
        weight = np.pad((~unknown).astype(float), ((0, rows % 2), (0, columns % 2)))

        def fold(a: Array) -> Array:
            return np.asarray(a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2])

        count = fold(weight)
        with np.errstate(invalid="ignore"):
            coarse = filled(np.where(count > 0, fold(even) / count, np.nan))
        guess = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[:rows, :columns]
    else:
        guess = np.full(values.shape, np.nanmean(values))
    out = np.where(unknown, guess, values)
    for _ in range(20):
        around = np.pad(out, 1, mode="edge")
        mean = 0.25 * (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:])
        out = np.where(unknown, mean, values)
    return out


def fast(n: int) -> int:
    """The least number from `n` on without a prime factor beyond 5: a length that transforms quickly."""
    while True:
        rest = n
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


def reflected(values: Array, before: tuple[int, int], size: tuple[int, int]) -> Array:
    """The map, `before` (rows, columns) into a plane of that size: its reflection in the edge values, let down to zero."""
    after = tuple(n - v - b for n, v, b in zip(size, values.shape, before, strict=True))
    out = np.pad(values, list(zip(before, after, strict=True)), mode="reflect", reflect_type="odd")
    for axis in (0, 1):
        low, high, n = before[axis], after[axis], values.shape[axis]
        away = np.concatenate([np.arange(low, 0, -1) / (low + 1), np.zeros(n), np.arange(1, high + 1) / (high + 1)])
        taper = 0.5 * (1.0 + np.cos(np.pi * away))
        out = out * (taper[:, None] if axis == 0 else taper[None, :])
    return np.asarray(out)


class Waves:
    """A map in wave numbers, once for all heights."""

    def __init__(self, values: Array, cell_m: tuple[float, float], edges: str) -> None:
        self.shape = (values.shape[0], values.shape[1])
        self.known = np.isfinite(values)
        if edges == "periodic":
            if not self.known.all():
                raise InvalidInputError(
                    f"edges='periodic': needed a map without holes, got {int((~self.known).sum())} of them"
                )
            self.before, self.size, self.plane = (0, 0), self.shape, np.zeros(self.shape)
        else:
            self.plane = np.full(self.shape, float(np.nanmean(values)))
            self.before = (self.shape[0] // 2, self.shape[1] // 2)
            self.size = (fast(self.shape[0] + 2 * self.before[0]), fast(self.shape[1] + 2 * self.before[1]))
            self.before = ((self.size[0] - self.shape[0]) // 2, (self.size[1] - self.shape[1]) // 2)
        ky = 2 * np.pi * np.fft.fftfreq(self.size[0], cell_m[1])
        kx = 2 * np.pi * np.fft.rfftfreq(self.size[1], cell_m[0])
        self.k = np.hypot(ky[:, None], kx[None, :])
        self.edges = edges
        # What is known, continued alike, says how much of a value comes from beyond.
        self.cover = None
        if edges == "periodic":
            self.waves = np.fft.rfft2(values)
            return
        self.cover = np.fft.rfft2(self._laid(self.known.astype(float)))
        self.waves = self._foretold(values - self.plane) if edges == "foretold" else self._mirrored(values - self.plane)

    def _laid(self, values: Array) -> Array:
        out = np.zeros(self.size)
        out[self._window] = values
        return out

    @property
    def _window(self) -> tuple[slice, slice]:
        return (
            slice(self.before[0], self.before[0] + self.shape[0]),
            slice(self.before[1], self.before[1] + self.shape[1]),
        )

    def _mirrored(self, values: Array) -> npt.NDArray[np.complex128]:
        if min(self.before) > min(self.shape) - 1:
            return np.asarray(np.fft.rfft2(self._laid(filled(values))))
        return np.asarray(np.fft.rfft2(reflected(filled(values), self.before, self.size)))

    def _foretold(self, values: Array) -> npt.NDArray[np.complex128]:
        """What the known values foretell of the others, for a field whose power falls with the third power of its wave number.

        The least field, measured by that spectrum, that meets the values: conjugate gradients, each step some transforms. What
        the last of them leaves is continued as the reflection of itself.
        """
        known = np.where(self.known, values, 0.0)
        scale = float(np.sqrt((known**2).sum() / self.known.sum()))
        if scale == 0.0:
            return np.asarray(np.fft.rfft2(self._laid(known)))
        longest = float(self.k[self.k > 0].min())
        power = (self.k**2 + longest**2) ** (-0.5 * FALL)
        power = power / power.max() + LEAST

        def through(field: Array, transfer: Array) -> Array:
            return np.where(self.known, self._cut(np.fft.rfft2(self._laid(field)) * transfer), 0.0)

        steps = STEPS if self.k.size < LARGE else STEPS // 3
        solution, left = np.zeros(self.shape), known.copy()
        towards = step = through(left, 1.0 / power)
        product = float((left * towards).sum())
        for _ in range(steps):
            seen = through(step, power)
            length = product / float((step * seen).sum())
            solution += length * step
            left = left - length * seen
            if np.sqrt((left**2).sum() / self.known.sum()) < CLOSE * scale:
                break
            towards = through(left, 1.0 / power)
            before, product = product, float((left * towards).sum())
            step = towards + product / before * step
        waves = np.fft.rfft2(self._laid(solution)) * power
        return np.asarray(waves + self._mirrored(np.where(self.known, left, np.nan)))

    def _cut(self, waves: npt.NDArray[np.complex128]) -> Array:
        whole = np.fft.irfft2(waves, s=self.size)
        return np.asarray(whole[self._window])

    def through(self, transfer: Array, *, plane: float = 1.0) -> Array:
        """Values after a filter that multiplies every wave, and the plane taken away."""
        return self._cut(self.waves * transfer) + plane * self.plane

    def beyond(self, height_m: float) -> Array:
        """Share of a value `height_m` further up that comes from where nothing is known."""
        if self.cover is None:
            return np.zeros(self.shape)
        return np.clip(1.0 - self._cut(self.cover * np.exp(-self.k * abs(height_m))), 0.0, 1.0)

    def scale(self) -> float:
        """Integral scale of the map, metres: over which it is much the same."""
        rings, power = self.power()
        return float((power / rings).sum() / max(power.sum(), 1e-300))

    def power(self) -> tuple[Array, Array]:
        """Wave numbers of rings, and the variance of the map in each."""
        weight = np.full(self.k.shape, 2.0)
        weight[:, 0] = 1.0
        if self.size[1] % 2 == 0:
            weight[:, -1] = 1.0
        energy = weight * np.abs(self.waves) ** 2 / (self.size[0] * self.size[1]) ** 2
        energy[0, 0] = 0.0
        # As a variance over the map, not over the map and its reflection, which is let down.
        inside = self.through(np.ones(()), plane=0.0)[self.known]
        rings = np.linspace(0.0, float(self.k.max()) * 1.0001, max(16, min(self.size)) + 1)
        of_ring = np.bincount(np.digitize(self.k.ravel(), rings) - 1, energy.ravel(), minlength=rings.size - 1)
        total = of_ring.sum()
        share = float(inside.var()) / total if total > 0 else 0.0
        return 0.5 * (rings[1:] + rings[:-1]), of_ring[: rings.size - 1] * share
