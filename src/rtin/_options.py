"""What the algorithms on a grid check at their doors alike."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtin._number import as_number
from rtin.grid import Grid

__all__ = [
    "as_count",
    "as_exaggeration",
    "as_height",
    "as_tolerance_map",
    "as_zero_or_more",
    "require_word",
    "the_only_option",
]

_LARGEST_EXAGGERATION = 1e6  # and one over it is the least
MOST = int(np.iinfo(np.int64).max)  # no limit on a count


def the_only_option(**options: Any) -> tuple[str, Any]:  # noqa: ANN401
    """Return name and value of the one option that is not None, or raise ValueError."""
    given = {name: value for name, value in options.items() if value is not None}
    if len(given) != 1:
        names = ", ".join(options)
        raise ValueError(f"give exactly one of {names}; got {', '.join(given) or 'none of them'}")
    return next(iter(given.items()))


def require_word(name: str, value: Any, words: Iterable[str]) -> None:  # noqa: ANN401
    """Raise ValueError where an option is none of the words that it may be."""
    if not isinstance(value, str) or value not in words:
        raise ValueError(f"{name} must be {' or '.join(map(repr, words))}, got {value!r}")


def as_height(name: str, value: Any) -> float:  # noqa: ANN401
    """Return a height of zero or more as a float; raise TypeError or ValueError otherwise."""
    return as_zero_or_more(name, value, "in the raster's height units")


def as_zero_or_more(name: str, value: Any, unit: str) -> float:  # noqa: ANN401
    """Return any such number as a float; ``unit`` is for the message."""
    number = as_number(name, value)
    if not number >= 0.0:
        raise ValueError(f"{name} must be zero or more, {unit}, got {number}")
    return number


def as_exaggeration(value: Any) -> float:  # noqa: ANN401
    """Return what heights are multiplied by to be drawn; raise TypeError or ValueError."""
    times = as_number("exaggeration", value)
    if not 1.0 / _LARGEST_EXAGGERATION <= times <= _LARGEST_EXAGGERATION:
        raise ValueError(f"exaggeration must be from 1e-06 to 1e+06, got {times:g}")
    return times


def as_count(name: str, value: Any) -> int:  # noqa: ANN401
    """Return a whole number; raise TypeError for anything else."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} must be a whole number, got {value!r}")
    return min(int(value), MOST)


def as_tolerance_map(grid: Grid, name: str, value: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Return a height for each sample of the grid, zero or more where the sample has one.

    Raises
    ------
    TypeError
        If these are no real numbers.
    ValueError
        If the shape is not the grid's, or one is negative or NaN.
    """
    tolerance = np.asarray(value)
    if tolerance.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold numbers, got an array of {tolerance.dtype}")
    if tolerance.shape != grid.shape:
        raise ValueError(
            f"{name} must be a number or have the grid's shape {grid.shape}, "
            f"got an array of shape {tolerance.shape}"
        )
    bad = ~(tolerance >= 0.0) & ~np.isnan(grid.heights)
    if bad.any():
        row, col = np.argwhere(bad)[0]
        raise ValueError(
            f"{name} must be zero or more, in the raster's height units, "
            f"got {tolerance[row, col]} at row {row}, column {col}"
        )
    return np.ascontiguousarray(tolerance, np.float64)
