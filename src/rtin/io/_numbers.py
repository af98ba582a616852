"""Numbers that come from people and from files, checked before anything is done with them."""

from __future__ import annotations

__all__ = ["require_plausible"]

# zlib makes at most 1032 bytes of one, 86 points or triangles; the other formats do not compress.
_MOST_PER_BYTE = 100


def require_plausible(count: int, n_bytes: int) -> None:
    """Raise ValueError where a file of ``n_bytes`` announces more than it can hold.

    Readers make room for what is announced: a damaged number would cost all memory.
    """
    if count > _MOST_PER_BYTE * n_bytes:
        raise ValueError(f"{count:,} values are announced in {n_bytes:,} bytes: it is damaged")
