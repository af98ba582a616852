"""Coordinate reference systems, in the one form that the package keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyproj

__all__ = ["as_crs"]


def as_crs(value: Any) -> pyproj.CRS | None:  # noqa: ANN401
    """Return ``value`` as a pyproj CRS; None stays None. Raises ValueError for an unknown one."""
    if value is None:
        return None
    import pyproj

    try:
        return pyproj.CRS.from_user_input(value)
    except pyproj.exceptions.CRSError as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"crs must be one that pyproj knows, got {value!r}: {reason}") from None
