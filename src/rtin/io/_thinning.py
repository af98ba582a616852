"""Every second, third, … row and column of an open raster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Thinned", "n_decoded"]

Span = tuple[int, int]
_MOST_AT_ONCE = 1 << 24  # samples


class Thinned:
    """A raster's dataset of which only every ``step``-th row and column of a part is read.

    It has the attributes of rasterio's dataset, and reads what is left as a whole. Blocks of the
    file between two samples are passed over; overviews are not looked at.

    Parameters
    ----------
    dataset : rasterio dataset, or array with two dimensions
    part : ((row_start, row_stop), (col_start, col_stop))
    step : int
    before_each : function, optional
        Called before each of the parts in which the file is read; what it raises ends the reading.

    Attributes
    ----------
    slices : (slice, slice)
        The rows and the columns taken.
    whole : ((0, rows), (0, cols))
        What is left: the only window that there is.
    """

    def __init__(
        self,
        dataset: Any,  # noqa: ANN401  (rasterio has no types)
        part: tuple[Span, Span],
        step: int,
        before_each: Callable[[], None] = lambda: None,
    ) -> None:
        self._dataset = dataset
        self._wanted = tuple(range(*span, step) for span in part)
        self._before_each = before_each
        self.slices = tuple(slice(*span, step) for span in part)
        self.whole = (0, len(self._wanted[0])), (0, len(self._wanted[1]))

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._dataset, name)

    def read(self, indexes: Any, **options: Any) -> NDArray[Any]:  # noqa: ANN401
        """Return the samples of one band, or of several."""
        return self._gathered(self._dataset.read, indexes, options)

    def read_masks(self, indexes: Any, **options: Any) -> NDArray[np.uint8]:  # noqa: ANN401
        """Return what a band's mask holds at the samples."""
        return self._gathered(self._dataset.read_masks, indexes, options)

    def _gathered(
        self,
        read: Callable[..., NDArray[Any]],
        indexes: Any,  # noqa: ANN401
        options: dict[str, Any],
    ) -> NDArray[Any]:
        assert options.pop("window") == self.whole, "there is one window only"
        gathered: NDArray[Any] | None = None
        rows, cols = self._wanted
        height, width = self._dataset.block_shapes[0]
        for row_span in _runs(rows, height, _MOST_AT_ONCE // (cols.stop - cols.start)):
            for col_span in _runs(cols, width, _MOST_AT_ONCE):
                self._before_each()
                part = read(indexes, window=(row_span, col_span), **options)
                (of_part, left), (of_cols, right) = _taken(row_span, rows), _taken(col_span, cols)
                if gathered is None:
                    shape = (*part.shape[:-2], len(rows), len(cols))
                    gathered = np.empty(shape, part.dtype)
                gathered[..., left, right] = part[..., of_part, of_cols]
        assert gathered is not None, "a part of a raster is not empty"
        return gathered


def n_decoded(shape: tuple[int, int], block: tuple[int, int], step: int) -> int:
    """Return about how many samples are decoded to read every ``step``-th row and column."""
    rows, cols = (
        min(size, -(-size // step) * length) for size, length in zip(shape, block, strict=True)
    )
    return rows * cols


def _runs(wanted: range, block: int, most: int) -> Iterator[Span]:
    """Yield the spans to read: one by one across blocks, else as many whole blocks as may be."""
    if wanted.step >= block:
        yield from ((index, index + 1) for index in wanted)
        return
    length = max(1, most // block) * block
    start = wanted.start
    while start < wanted.stop:
        stop = min((start // length + 1) * length, wanted.stop)
        yield start, stop
        start = stop


def _taken(span: Span, wanted: range) -> tuple[slice, slice]:
    """Return which of a span are wanted, and their place among all that are."""
    first, end = (-((wanted.start - bound) // wanted.step) for bound in span)
    return slice(wanted.start + first * wanted.step - span[0], None, wanted.step), slice(first, end)
