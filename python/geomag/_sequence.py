"""Delta modulation with its codes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._geomag import _delta_modulation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


class ChosenSamples(np.ndarray[Any, np.dtype[np.int64]]):
    """Indices of chosen samples, with the codes that chose them.

    An array of indices like any other; `codes` (uint8, one fewer than there were values: the first sample, where the
    staircase starts, has none) is lost by slicing and arithmetic.
    """

    codes: NDArray[np.uint8] | None

    def __array_finalize__(self, _source: object) -> None:
        self.codes = None


def delta_modulation(values: ArrayLike, quantum: float) -> ChosenSamples:
    """Choose the samples at which the field has run a quantum ahead of a staircase that follows it.

    For a matching sequence whose neighbours the sensor can tell apart. Not for flat field, where it chooses few
    samples or none; see `choose_sequence` for the sampling theorem besides.

    Parameters
    ----------
    values : array of shape (n,)
        Measured values.
    quantum : float
        Step of the staircase, value units, > 0: more than the sensor's noise.

    Returns
    -------
    ChosenSamples
        Ascending indices, with `.codes`.

    Raises
    ------
    InvalidInputError, NotFiniteError

    Notes
    -----
    F'(0) = F(0), F'(k) = F'(k-1) + sgn(F(k) - F'(k-1)) quantum, sgn(0) = +1; code(k) = 1 where the sign is +; sample k
    is chosen when code(k) = code(k-1). Source: Duan, Xiao, Qi, J. Astronautics 2018(2).

    Examples
    --------
    >>> import geomag
    >>> keep = geomag.delta_modulation([0.0, 1.0, 2.0, 3.0, 2.6], 1.0)
    >>> keep.tolist(), keep.codes.tolist()
    ([2, 3], [1, 1, 1, 0])
    """
    keep, codes = _delta_modulation(values, quantum)
    chosen = keep.view(ChosenSamples)
    chosen.codes = codes
    return chosen
