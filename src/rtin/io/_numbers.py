"""Numbers that come from people and from files, checked before anything is done with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtin._number import as_number

__all__ = ["as_positive", "require_plausible"]

# zlib makes at most 1032 bytes of one, 86 points or triangles; the other formats do not compress.
_MOST_PER_BYTE = 100


def as_positive(name: str, value: Any, unit: str = "") -> float:  # noqa: ANN401
    """Return ``value`` as a float; raise where it is no number, or not more than zero."""
    number = as_number(name, value)
    if not (np.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} must be more than zero{unit}, got {value}")
    return number


def require_plausible(count: int, n_bytes: int) -> None:
    """Raise ValueError where a file of ``n_bytes`` announces more than it can hold.

    Readers make room for what is announced: a damaged number would cost all memory.
    """
    if count > _MOST_PER_BYTE * n_bytes:
        raise ValueError(f"{count:,} values are announced in {n_bytes:,} bytes: it is damaged")
