"""Refuse what a command line cannot mean."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

__all__ = [
    "bytes_in",
    "flag_of",
    "require_mesh_out",
    "require_positive",
    "the_only_option",
    "values_are_usage",
]


@contextmanager
def values_are_usage() -> Iterator[None]:
    """Take a ValueError about what stands on the command line for bad usage."""
    try:
        yield
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def the_only_option(**options: float | str | Path | None) -> dict[str, Any]:
    """Return the one option given of several; none, more, and negative ones are bad usage."""
    given = {name: value for name, value in options.items() if value is not None}
    flags = ", ".join(flag_of(name) for name in options)
    if len(given) != 1:
        got = " and ".join(flag_of(name) for name in given) or "none"
        raise typer.BadParameter(f"exactly one of {flags} is wanted, got {got}")
    name, value = next(iter(given.items()))
    if isinstance(value, int | float) and not value >= 0:
        raise typer.BadParameter(f"{flag_of(name)} must be zero or more, got {value}")
    return given


def flag_of(name: str) -> str:
    return "--" + name.replace("_", "-")


def bytes_in(flag: str, text: str) -> int:
    from rtin._memory import as_bytes

    try:
        return as_bytes(text)
    except ValueError as error:
        raise typer.BadParameter(f"{flag}: {error}") from None


def require_positive(flag: str, value: float | None) -> None:
    if value is not None and not 0.0 < value < float("inf"):
        raise typer.BadParameter(f"{flag} must be more than zero, got {value}")


def require_mesh_out(out: Path, dem: Path | None) -> None:
    """Refuse an output that can't be written before any work is done."""
    from rtin.io.meshes import require_writable

    if dem is not None and out.exists() and dem.exists() and out.samefile(dem):
        raise typer.BadParameter(f"OUT must not be the raster itself, got {out} for both")
    with values_are_usage():
        require_writable(out)
