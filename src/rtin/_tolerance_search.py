"""The search for a tolerance just fine enough to exceed a budget of triangles."""

from __future__ import annotations

import math

__all__ = ["ToleranceSearch", "a_bit_finer"]

_NARROW = 1.01  # what is too coarse by what is too fine: less is not halved again
_FIRST_STEP, _LONG_STEP = 6.0, 10.0  # octaves of tolerance
_FINEST, _COARSEST = 1e-30, 1e300  # tolerances to look for


def a_bit_finer(tolerance: float) -> float:
    """Return a tolerance that exceeds the budget which another one only just keeps."""
    return 0.9 * tolerance


class ToleranceSearch:
    """A search for a tolerance just fine enough to exceed a budget, by walks at one after another.

    Parameters
    ----------
    tolerance : float
        Where it begins; what is found in the end does not hang on it, the number of walks does.

    Attributes
    ----------
    tolerance : float
        At which to walk next; 0 for all vertices.
    is_narrow : bool
        Whether the next walk is to go on to its end, however many vertices that takes.
    """

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.is_narrow = False
        self._too_fine, self._too_coarse = 0.0, math.inf
        self._n_before = 0  # vertices above the tolerance that was too coarse

    def go_coarser(self, least: float) -> None:
        """Go on after a walk that was broken off; what it found exceeds the budget at ``least``."""
        self._too_fine = max(self.tolerance, _FINEST)
        middle = _between(self._too_fine, min(self._too_coarse, _COARSEST))
        wanted = max(min(4.0 * self.tolerance, middle), a_bit_finer(least))
        self._go(min(wanted, _COARSEST) if wanted > self._too_fine else middle)

    def go_finer(self, n: int, n_wanted: float) -> None:
        """Go on after a walk that found n vertices, too few; at the rate of the last step."""
        if math.isinf(self._too_coarse):
            octaves = min(math.log2(max(n_wanted / n, 1.0)), _FIRST_STEP)
        else:
            gained = (n - self._n_before) / math.log2(self._too_coarse / self.tolerance)
            octaves = max(n_wanted - n, 0.0) / gained if gained > 0.0 else math.inf
        self._too_coarse, self._n_before = self.tolerance, n
        if octaves > _LONG_STEP and self._too_fine == 0.0:
            self._go(0.0)  # hardly anything is left to find
            return
        wanted = a_bit_finer(self.tolerance) * 2.0**-octaves
        self._go(max(wanted, _between(self._too_fine, self._too_coarse)))

    def _go(self, tolerance: float) -> None:
        if min(self._too_coarse, _COARSEST) < self._too_fine * _NARROW:
            # Many weigh the same, as all that voids demand do: walk over all of them.
            self.is_narrow = True
            tolerance, self._too_fine = self._too_fine, 0.0
        self.tolerance = tolerance if tolerance >= _FINEST else 0.0


def _between(fine: float, coarse: float) -> float:
    """Return as many times one tolerance as the other one is times it; their product may be inf."""
    return math.sqrt(fine) * math.sqrt(coarse)
