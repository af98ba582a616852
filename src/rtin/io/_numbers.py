"""Numbers that people pass to the writers."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["as_positive"]


def as_positive(name: str, value: Any, unit: str = "") -> float:  # noqa: ANN401
    """Return ``value`` as a float; raise where it is no number, or not more than zero."""
    wrong_kind = TypeError(f"{name} must be a number, got {value!r}")
    if isinstance(value, bool | np.bool_ | str | bytes) or np.ndim(value) != 0:
        raise wrong_kind
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise wrong_kind from None
    if not (np.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} must be more than zero{unit}, got {value}")
    return number
