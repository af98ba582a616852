"""The one test of what counts as a number."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["as_number", "as_positive"]


def as_number(name: str, value: Any) -> float:  # noqa: ANN401
    """Return ``value`` as a float.

    Raises TypeError where it is no number, as text and truth are, and ValueError where it is a
    whole number beyond all floats.
    """
    shape = getattr(value, "shape", ())  # an array would fill lines
    got = f"an array of shape {shape}" if shape else repr(value)
    wrong_kind = TypeError(f"{name} must be a number, got {got}")
    if isinstance(value, bool | np.bool_ | str | bytes) or np.ndim(value) != 0:
        raise wrong_kind
    try:
        return float(value)
    except (TypeError, ValueError):
        raise wrong_kind from None
    except OverflowError:
        raise ValueError(f"{name} must fit a float64, got a larger whole number") from None


def as_positive(name: str, value: Any, unit: str = "") -> float:  # noqa: ANN401
    """Return ``value`` as a float; raise where it is no number, or not more than zero."""
    number = as_number(name, value)
    if not (np.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} must be more than zero{unit}, got {value}")
    return number
