"""Rasters of any size, and meshes, opened to be looked at: first a coarse one, then the whole.

What is read first takes a second or three: an overview of the file, or every so many samples. Each
stage after that has up to sixteen times the samples of the one before, and the last every sample,
or as many as fit in memory. All of them together take little longer than the last.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._memory import as_text
from rtin.grid import Grid, Metres
from rtin.io._levels import RasterLevels, Reading
from rtin.io.grids import available_memory
from rtin.io.meshes import is_mesh_path, read_mesh
from rtin.mesh import TriangleMesh

if TYPE_CHECKING:
    import pyproj

__all__ = ["Opened", "Opening", "mesh_in_metres"]

_FIRST_SAMPLES = 1_100_000  # a hierarchy over them takes a third of a second, on two cores
_MOST_DECODED = 150_000_000  # samples, to read those: one to three seconds
_FINER = 16  # times the samples of the stage before, at most
_WORTH_IT = 8  # times fewer samples than the whole: what is shown before that
# Of a sample while it is read and prepared: what is read, its mask, and the hierarchy.
_BYTES_NARROW, _BYTES_WIDE = 14, 26
_PATIENCE = 1.0  # second that closing waits for what is being read or made of it
_IDENTITY = Affine.identity()


@dataclass(frozen=True, eq=False)
class Opened:
    """A terrain as it has been opened so far.

    Attributes
    ----------
    surface : Grid or TriangleMesh
        x and y in metres round the middle of the *whole* raster or mesh where its CRS is
        geographic, and in the CRS otherwise: the same for each stage.
    bounds : ndarray of float64, shape (2, 2)
        Least and largest x and y of all the raster's samples, or of the mesh: the same for each
        stage, and at most one spacing of samples beyond those of ``surface``.
    crs : pyproj.CRS or None
        Of the file.
    to_crs : affine.Affine
        Maps x and y of the surface to those of ``crs``.
    step : float
        How many of the raster's rows, or columns, lie from one sample to the next; 1 for all.
    is_final : bool
        Whether nothing finer will come.
    note : str
        What there is to be seen, in one line.
    """

    surface: Grid | TriangleMesh
    bounds: NDArray[np.float64]
    crs: pyproj.CRS | None
    to_crs: Affine
    step: float
    is_final: bool
    note: str

    def from_crs(self, point: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return x, y and z of the surface for a point in the CRS of the file."""
        a, b, x0, d, e, y0 = tuple(self.to_crs)[:6]
        x, y = np.linalg.solve([[a, b], [d, e]], [point[0] - x0, point[1] - y0]).tolist()
        return x, y, point[2]

    def into_crs(self, point: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return x, y and z in the CRS of the file for a point of the surface."""
        a, b, x0, d, e, y0 = tuple(self.to_crs)[:6]
        x, y, z = point
        return a * x + b * y + x0, d * x + e * y + y0, z


class Opening:
    """A raster or a mesh that is being opened; a context, which ends that.

    Parameters
    ----------
    path, band, encoding
        As in ``read_grid``; or the path of what ``read_mesh`` reads.
    memory_limit : int, optional
        Bytes that reading and preparing may take: of a raster that needs more, as many samples are
        read as fit, and ``Opened.note`` says so. By default half of the memory that is free.

    Raises
    ------
    OSError, TypeError, ValueError
        As ``read_grid``, as far as no height is needed for it.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        band: int = 1,
        encoding: Literal["terrain-rgb", "terrarium", "none"] | None = None,
        memory_limit: int | None = None,
    ) -> None:
        self._path = path
        is_mesh = is_mesh_path(Path(path))
        self._raster = None if is_mesh else _Raster(path, band, encoding, memory_limit)
        self._stages = iter(()) if self._raster is None else self._raster.stages()
        self._is_closed = threading.Event()
        self._thread: threading.Thread | None = None
        self._is_whole = False

    def first(self) -> Opened:
        """Return what can be had in a second or three, whatever the size of the raster.

        A mesh is read whole. So is a raster of about a million samples. Without overviews the
        first grid of a very large raster is coarse: only so many blocks are decoded. One whose
        samples make no triangle is not shown: the next one is.

        Raises
        ------
        OSError, TypeError, ValueError, MemoryError
            As ``read_grid`` and ``read_mesh``.
        """
        opened = _opened_mesh(self._path) if self._raster is None else next(self._all_opened())
        self._is_whole = opened.is_final
        return opened

    def finest(self) -> Opened:
        """Return the last stage at once, in the place of ``first``; it raises what that raises."""
        if self._raster is None:
            return self.first()
        reading, self._is_whole = list(self._stages)[-1]
        heights = self._raster.levels.read(reading, self._require_open)
        return self._raster.opened(heights, reading, self._is_whole)

    def go_on(
        self, on_opened: Callable[[Opened], None], on_failure: Callable[[Exception], None]
    ) -> None:
        """Open the finer stages in the background, after ``first``.

        Parameters
        ----------
        on_opened : function
            Called with each of them in a thread of its own, the last one final. The next one is
            read when it returns. Not called at all where the first one was final.
        on_failure : function
            Called in that thread with what went wrong, be it in ``on_opened``; then no more comes.
        """
        if self._is_whole or self._thread is not None:
            return
        self._thread = threading.Thread(
            target=self._go_on, args=(on_opened, on_failure), name="rtin-opening", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop reading: no callback begins after this.

        Waits a second at most for a part that is being read, or for a callback that is not done.
        """
        self._is_closed.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    def __enter__(self) -> Opening:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _go_on(
        self, on_opened: Callable[[Opened], None], on_failure: Callable[[Exception], None]
    ) -> None:
        try:
            for opened in self._all_opened():
                self._require_open()
                on_opened(opened)
        except _ClosedError:
            pass
        except Exception as error:
            if not self._is_closed.is_set():
                on_failure(error)

    def _all_opened(self) -> Iterator[Opened]:
        """Yield the stages that are left and that have something to be seen."""
        assert self._raster is not None, "a mesh has one stage"
        for reading, is_final in self._stages:
            heights = self._raster.levels.read(reading, self._require_open)
            if is_final or _has_a_triangle(heights):
                yield self._raster.opened(heights, reading, is_final)

    def _require_open(self) -> None:
        if self._is_closed.is_set():
            raise _ClosedError


class _ClosedError(Exception):
    """Nobody wants to know any more."""


class _Raster:
    """What is read of a raster file, stage by stage, and where that lies."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        band: int,
        encoding: str | None,
        memory_limit: int | None,
    ) -> None:
        self.levels = RasterLevels.of(path, band, encoding)
        self._per_sample = _BYTES_NARROW if self.levels.itemsize <= 4 else _BYTES_WIDE
        available = available_memory()
        self._limit = memory_limit or (np.inf if available is None else available // 2)
        crs, ends = self.levels.crs, _ends(self.levels.transform, self.levels.shape)
        self._metres = None
        if crs is not None and crs.is_geographic:
            self._metres = Metres.around(crs, *ends.mean(axis=0).tolist())
            ends = _ends(self._metres.of(self.levels.transform), self.levels.shape)
        self._bounds = np.array([ends.min(axis=0), ends.max(axis=0)])

    def stages(self) -> Iterator[tuple[Reading, bool]]:
        """Yield what to read, the last one marked as such."""
        final = self.levels.thinned(min(self._limit / self._per_sample, 2**62))
        most = min(_FIRST_SAMPLES, final.n_samples)
        reading = self.levels.within(most, _MOST_DECODED)
        while _WORTH_IT * reading.n_samples <= final.n_samples:
            yield reading, False
            if most == final.n_samples:
                break
            if _FINER * reading.n_samples >= most:  # else it is coarse for want of time
                most = min(_FINER * most, final.n_samples)
            reading = self.levels.within(most)
        yield final, True

    def opened(
        self, heights: NDArray[np.floating[Any]], reading: Reading, is_final: bool
    ) -> Opened:
        levels, metres = self.levels, self._metres
        place = levels.place(reading)
        try:
            if metres is None:
                grid = Grid(heights, place, levels.crs)
            else:
                grid = Grid(heights, metres.of(place))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{levels.name}: {error}") from None
        to_crs = _IDENTITY if metres is None else metres.undone()
        step = max(levels.spacing(reading))
        note = self._note(step, is_final)
        return Opened(grid, self._bounds, levels.crs, to_crs, step, is_final, note)

    def _note(self, step: float, is_final: bool) -> str:
        """Return what is to be seen, and why no more than that."""
        rows, cols = self.levels.shape
        if step == 1.0:
            return f"all {rows} × {cols} samples"
        what = f"one in {step:.3g} × {step:.3g} samples of {rows} × {cols}"
        if not is_final:
            return f"{what}; the rest is being read"
        needed, limit = as_text(rows * cols * self._per_sample), as_text(self._limit)
        return f"{what}; all of them take {needed} of memory, and {limit} may be taken"


def _ends(transform: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return x and y of the four outermost samples, shape (4, 2)."""
    a, b, x, d, e, y = tuple(transform)[:6]
    rows, cols = shape[0] - 1, shape[1] - 1
    corners = [(0, 0), (cols, 0), (0, rows), (cols, rows)]
    return np.array([(a * c + b * r + x, d * c + e * r + y) for c, r in corners])


def _has_a_triangle(heights: NDArray[np.floating[Any]]) -> bool:
    """Return whether three samples of a cell have heights."""
    valid = (heights == heights).view(np.uint8)
    pairs = valid[:-1] + valid[1:]
    return bool((pairs[:, :-1] + pairs[:, 1:] >= 3).any())


def mesh_in_metres(mesh: TriangleMesh) -> tuple[TriangleMesh, Affine]:
    """Return a mesh as ``Grid.in_metres`` has grids, and what maps its x and y back."""
    if mesh.crs is None or not mesh.crs.is_geographic:
        return mesh, _IDENTITY
    metres = Metres.around(mesh.crs, *mesh.bounds[:, :2].mean(axis=0).tolist())
    shift, scale = (metres.x, metres.y, 0.0), (metres.east, metres.north, 1.0)
    vertices = (mesh.vertices - shift) * scale
    return TriangleMesh(vertices, mesh.triangles, tags=mesh.tags), metres.undone()


def _opened_mesh(path: str | os.PathLike[str]) -> Opened:
    read = read_mesh(path)
    mesh, to_crs = mesh_in_metres(read)
    bounds = mesh.bounds[:, :2]
    note = f"{mesh.n_triangles:,} triangles"
    return Opened(mesh, bounds, read.crs, to_crs, 1.0, True, note)
