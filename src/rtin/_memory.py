"""Sizes of memory as people write them."""

from __future__ import annotations

import re

__all__ = ["as_bytes", "as_text"]

_FACTORS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
_BINARY_FACTORS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}


def as_bytes(text: str) -> int:
    """Return the bytes of a size such as 500MB, 2GB or 1.5GiB; raise ValueError for another text.

    Without a unit it is bytes; capitals or not make no difference, nor does a missing B.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]?)(i?)b?\s*", text, re.IGNORECASE)
    factors = _BINARY_FACTORS if found and found[3] else _FACTORS
    factor = factors.get(found[2].upper()) if found else None
    size = 0 if found is None or factor is None else int(float(found[1]) * factor)
    if size < 1:
        raise ValueError(
            f"a size of memory must be a number with a unit, such as 500MB, 2GB or 1.5GiB, "
            f"got {text!r}"
        )
    return size


def as_text(n_bytes: float) -> str:
    """Return a size in the unit that fits."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if n_bytes >= factor:
            return f"{n_bytes / factor:.3g} {unit}"
    return f"{n_bytes / 1e3:.3g} kB"
