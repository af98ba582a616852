"""``da.rtin``: the terrain functions as methods of an ``xarray.DataArray``.

``import rtin.accessor`` registers them; ``import rtin`` alone does not, so that it need not load
xarray.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rtin.coarsening import coarsen
from rtin.grid import Grid
from rtin.mesh import TriangleMesh

try:
    import xarray
except ImportError:
    raise ImportError("rtin.accessor needs xarray: pip install 'rtin[xarray]'") from None

with suppress(ImportError):
    import rioxarray  # noqa: F401  (gives an array the CRS and the nodata value that Grid reads)

__all__ = ["RtinAccessor"]


@xarray.register_dataarray_accessor("rtin")  # type: ignore[no-untyped-call]
class RtinAccessor:
    """The terrain functions of one ``xarray.DataArray``, found at ``da.rtin``."""

    def __init__(self, data: xarray.DataArray) -> None:
        self._data = data

    @property
    def grid(self) -> Grid:
        """The array as a ``Grid``; see ``Grid.from_xarray`` for what it takes and refuses."""
        return Grid.from_xarray(self._data)

    def coarsen(self, **options: Any) -> TriangleMesh:  # noqa: ANN401
        """Return ``rtin.coarsen`` of the array: ``da.rtin.coarsen(max_error=5.0)``.

        Takes the keyword arguments of ``rtin.coarsen`` and raises what that and
        ``Grid.from_xarray`` raise.
        """
        return coarsen(self.grid, **options)
