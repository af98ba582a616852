"""Tilesets in a folder: made from rasters in any number of goes, each tile whole or not at all.

Beside the tiles lies a folder ``.rtin`` with what is known of them: ``job.json`` (the settings and
the state of the rasters), the heights of coarser zooms, the settled borders, and ``tiles.sqlite``
with a row for each finished tile. A run that was ended early goes on from there.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rtin._atomic import write_bytes
from rtin.pyramid import Level, Plan, prepare, shares
from rtin.tiles import Borders, Place, Tile, Tiling, make_tile

__all__ = ["Format", "LevelSummary", "Summary", "TileRecord", "write_tileset"]

_STATE = ".rtin"
_BATCH = 8  # tiles along a side of what a worker makes in one go
_MOST_IN_FLIGHT = 64
_SETTLING_SHARE = 0.4  # of the time


class Format(Protocol):
    """How tiles are written; goes to other processes with each batch."""

    def name(self, zoom: int, row: int, col: int) -> str:
        """Return the path of a tile in the folder; rows are counted from the north."""

    def encode(self, zoom: int, tile: Tile, largest_range: float) -> bytes:
        """Return the tile's file; within a tile of the zoom, heights differ by that at most.

        That range has a say through ``rounding`` only: tiles stay as they are while it stays.
        """

    def rounding(self, zoom: int, largest_range: float) -> float:
        """Return how far the format may move a height."""

    def roots(self, zoom: int) -> frozenset[Place]:
        """Return tiles of a zoom that must be there, with or without heights."""

    def index(
        self, records: Callable[[], Iterator[TileRecord]], tolerances: dict[int, float]
    ) -> Iterator[tuple[str, bytes]]:
        """Yield path and content of the files that say which tiles there are."""


@dataclass(frozen=True)
class TileRecord:
    """What is known of a finished tile; heights and errors in metres or the raster's unit."""

    zoom: int
    row: int
    col: int
    n_bytes: int  # 0: there is nothing to draw, and no file
    n_vertices: int
    n_triangles: int
    error: float
    low: float
    high: float
    key: bytes  # of all that the file depends on
    rasters: bytes  # when it was looked at last


@dataclass(frozen=True)
class LevelSummary:
    """Figures of one zoom.

    Attributes
    ----------
    tolerance, max_error : float
        What was asked for, and the largest distance of a node from the tiles as written: as
        measured on the meshes, and half a step of the heights where the format has steps.
    n_tiles, n_vertices, n_triangles, n_bytes : int
    """

    zoom: int
    tolerance: float
    max_error: float
    n_tiles: int
    n_vertices: int
    n_triangles: int
    n_bytes: int


@dataclass(frozen=True)
class Summary:
    """What a run has done: tiles written and removed, and all that there is now."""

    levels: list[LevelSummary]
    n_made: int
    n_removed: int


def write_tileset(
    folder: str | os.PathLike[str],
    plan: Plan,
    output: Format,
    *,
    settings: dict[str, Any],
    sources: dict[str, str],
    update: bool = False,
    executor: Executor | None = None,
    tell: Callable[[float], object] | None = None,
) -> Summary:
    """Make the tiles of a pyramid in a folder, as far as they are not there yet.

    Whatever ends a run early, what it has finished is kept, and the next run with the same settings
    goes on. The files do not depend on the number of workers or of goes.

    Parameters
    ----------
    folder : path
        New, empty, or with a tileset of the same settings.
    plan : Plan
    output : Format
    settings : dict
        Of all that the files depend on but the rasters' heights, as JSON would hold it.
    sources : dict of str to str
        What tells the state of each raster, by its name.
    update : bool
        Whether the tiles that a changed raster touches are made anew; the others stay as they are.
    executor : concurrent.futures.Executor, optional
        Where tiles are made; its workers must see the same folder.
    tell : callable, optional
        Called with the share of the work that is done.

    Raises
    ------
    FileExistsError
        If the folder holds something else, or a tileset made with other settings.
    ValueError
        If a raster has changed and ``update`` is False.
    OSError
        If a raster can't be read, the folder can't be written, or another run is writing to it.
    """
    folder = Path(folder)
    tell = tell or (lambda _: None)
    state = _opened(folder, settings)
    with _locked(state), _table(state / "tiles.sqlite") as table:
        goes_on = _start(state, table, settings, sources, update=update)
        heard = shares(plan, lambda share: tell(_SETTLING_SHARE * share))
        levels = prepare(plan, state, executor=executor, tell=heard)
        levels = {zoom: level.with_tiles(output.roots(zoom)) for zoom, level in levels.items()}
        rasters = blake2b(json.dumps(sources).encode(), digest_size=8).digest()
        n_made, n_emptied = _make_all(folder, table, levels, output, rasters, executor, tell)
        n_removed = n_emptied + _remove_stale(folder, table, levels, output)
        names = set()
        for name, content in output.index(partial(_drawn, table), plan.tolerances):
            _write(folder / name, content)
            names.add(name)
        if goes_on:
            _remove_unknown(folder, table, levels, output, names)
        _write_job(state, settings, sources, finished=True)
        return Summary(_summaries(table, plan, levels, output), n_made, n_removed)


def _drawn(table: sqlite3.Connection) -> Iterator[TileRecord]:
    """Yield the tiles that have a file."""
    return (record for record in _records(table) if record.n_bytes > 0)


# --- the state ----------------------------------------------------------------------------------


def _opened(folder: Path, settings: dict[str, Any]) -> Path:
    """Return the folder of the state, made if need be; refuse a folder of something else."""
    state = folder / _STATE
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder} is a file; name a folder for the tiles")
    if not state.exists() and folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty and holds no tileset; name a new folder")
    job = _job(state)
    for name, value in settings.items():
        if job is not None and job["settings"].get(name) != value:
            raise FileExistsError(
                f"{folder} holds tiles made with {name} = {_short(job['settings'].get(name))}, "
                f"not {_short(value)}; name another folder, or remove this one first"
            )
    state.mkdir(parents=True, exist_ok=True)
    return state


def _short(value: Any) -> str:  # noqa: ANN401
    """Return a setting in few words: of those for each zoom, that of the last one."""
    if isinstance(value, dict) and value:
        zoom, of_zoom = list(value.items())[-1]
        return f"{of_zoom} at zoom {zoom}"
    return str(value)


def _start(
    state: Path,
    table: sqlite3.Connection,
    settings: dict[str, Any],
    sources: dict[str, str],
    *,
    update: bool,
) -> bool:
    """Note what is going to be made; drop what was derived from rasters as they no longer are.

    Returns whether an earlier run may have left files that are not of this tileset.
    """
    job = _job(state)
    changed = job is not None and list(job["sources"].items()) != list(sources.items())
    if job is not None and changed and not update:
        names = [name for name in sources if job["sources"].get(name) != sources[name]]
        gone = [name for name in job["sources"] if name not in sources]
        raise ValueError(
            f"{', '.join(names + gone) or 'the order of the rasters'} changed since {state.parent} "
            "was made; add --update to make the tiles that it touches anew"
        )
    if job is not None and changed:
        # Heights are taken for whole where borders are settled: these go first.
        for path in (*state.glob("settled-*"), *state.glob("heights-*")):
            path.unlink()
        if not job["finished"]:  # tiles may be newer than what is known of them
            with table:
                table.execute("UPDATE tiles SET key = x'', rasters = x''")
    for part in state.parent.rglob(".*.part*"):  # of a run that was killed
        part.unlink(missing_ok=True)
    is_finished = job is not None and job["finished"] and not changed
    _write_job(state, settings, sources, finished=is_finished)
    return job is not None and not is_finished


def _job(state: Path) -> dict[str, Any] | None:
    with suppress(FileNotFoundError):
        job: dict[str, Any] = json.loads((state / "job.json").read_text())
        return job
    return None


def _write_job(
    state: Path, settings: dict[str, Any], sources: dict[str, str], *, finished: bool
) -> None:
    job = {"settings": settings, "sources": sources, "finished": finished}
    write_bytes(state / "job.json", json.dumps(job, indent=1).encode())


@contextmanager
def _locked(state: Path) -> Iterator[None]:
    """Hold the folder for this process alone, until it ends in whatever way."""
    try:
        import fcntl
    except ImportError:  # Windows: nobody is kept out
        yield
        return
    with (state / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OSError(
                f"{state.parent} is being written by another run; wait for it, or end it first"
            ) from None
        yield


@contextmanager
def _table(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the table of finished tiles; raise every failure as an OSError."""
    fields = ", ".join(TileRecord.__dataclass_fields__)
    try:
        table = sqlite3.connect(path)
        try:
            table.execute("PRAGMA journal_mode = WAL")
            table.execute(
                f"CREATE TABLE IF NOT EXISTS tiles ({fields}, PRIMARY KEY (zoom, row, col))"
            )
            yield table
        finally:
            table.close()
    except sqlite3.Error as error:
        raise OSError(f"cannot keep the list of finished tiles in {path}: {error}") from None


def _records(table: sqlite3.Connection, zoom: int | None = None) -> Iterator[TileRecord]:
    """Yield what is known of every tile that was looked at, zoom by zoom and row by row."""
    rows = table.execute(
        "SELECT * FROM tiles WHERE ? IS NULL OR zoom = ? ORDER BY zoom, row, col", (zoom, zoom)
    )
    return (TileRecord(*row) for row in rows)


def _insert(table: sqlite3.Connection, records: Iterable[TileRecord]) -> None:
    marks = ", ".join("?" * len(TileRecord.__dataclass_fields__))
    with table:
        table.executemany(
            f"INSERT OR REPLACE INTO tiles VALUES ({marks})",
            [tuple(vars(record).values()) for record in records],
        )


# --- making -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Batch:
    """Some tiles of one zoom, with all that a worker needs to make them."""

    folder: Path
    output: Format
    zoom: int
    tiling: Tiling
    largest_range: float
    rasters: bytes
    places: list[Place]
    borders: Borders
    before: dict[Place, TileRecord]


def _make_all(
    folder: Path,
    table: sqlite3.Connection,
    levels: dict[int, Level],
    output: Format,
    rasters: bytes,
    executor: Executor | None,
    tell: Callable[[float], object],
) -> tuple[int, int]:
    """Make what is missing or no longer true; return how many files were written and removed."""
    n_all = sum(len(level.available) for level in levels.values())
    n_done = n_made = n_emptied = 0
    for level in reversed(levels.values()):
        before = {(record.row, record.col): record for record in _records(table, level.zoom)}
        todo = [
            place
            for place in sorted(level.available)
            if place not in before
            or before[place].rasters != rasters
            or not _is_in_place(folder, output, before[place])
        ]
        n_done += len(level.available) - len(todo)
        batches = (
            _batch(folder, output, level, rasters, places, before) for places in _squares(todo)
        )
        for records, n_written in _run(executor, _make_batch, batches):
            _insert(table, records)
            n_done, n_made = n_done + len(records), n_made + n_written
            n_emptied += sum(_is_emptied(record, before) for record in records)
            tell(_SETTLING_SHARE + (1.0 - _SETTLING_SHARE) * n_done / n_all)
    return n_made, n_emptied


def _is_emptied(record: TileRecord, before: dict[Place, TileRecord]) -> bool:
    old = before.get((record.row, record.col))
    return old is not None and old.n_bytes > 0 == record.n_bytes


def _squares(places: Iterable[Place]) -> list[list[Place]]:
    """Return the tiles in squares of some, so that a worker reads neighbours together."""
    squares: dict[Place, list[Place]] = {}
    for row, col in places:
        squares.setdefault((row // _BATCH, col // _BATCH), []).append((row, col))
    return list(squares.values())


def _batch(
    folder: Path,
    output: Format,
    level: Level,
    rasters: bytes,
    places: list[Place],
    before: dict[Place, TileRecord],
) -> _Batch:
    known = level.settled.borders
    edges = {edge for place in places for edge in level.tiling.edges(place)}
    return _Batch(
        folder,
        output,
        level.zoom,
        level.tiling,
        level.settled.largest_range,
        rasters,
        places,
        {edge: known[edge] for edge in edges if edge in known},
        {place: before[place] for place in places if place in before},
    )


def _make_batch(batch: _Batch) -> tuple[list[TileRecord], int]:
    """Make the tiles of a batch that are not as they should be; return all, and how many made."""
    records, n_made = [], 0
    for place, heights in batch.tiling.read(batch.places):
        key = _key(batch, place, heights)
        record = batch.before.get(place)
        if (
            record is None
            or record.key != key
            or not _is_in_place(batch.folder, batch.output, record)
        ):
            record = _store(batch, place, key, heights)
            n_made += record.n_bytes > 0
        records.append(replace(record, rasters=batch.rasters))
    return records, n_made


def _key(batch: _Batch, place: Place, heights: NDArray[np.floating[Any]]) -> bytes:
    """Return a digest of all that a tile's file depends on, but the settings of the whole."""
    digest = blake2b(heights.tobytes(), digest_size=16)
    # Not in decimals, which Python has no more than 4300 of.
    borders = [hex(batch.borders.get(edge, 0)) for edge in batch.tiling.edges(place)]
    rounding = batch.output.rounding(batch.zoom, batch.largest_range)
    digest.update(repr((borders, rounding)).encode())
    return digest.digest()


def _is_in_place(folder: Path, output: Format, record: TileRecord) -> bool:
    path = folder / output.name(record.zoom, record.row, record.col)
    with suppress(FileNotFoundError):
        return record.n_bytes in (0, path.stat().st_size)
    return False


def _store(
    batch: _Batch, place: Place, key: bytes, heights: NDArray[np.floating[Any]]
) -> TileRecord:
    """Make a tile and write its file; return what is to be known of it."""
    (zoom, (row, col)), rasters = (batch.zoom, place), batch.rasters
    tile = make_tile(batch.tiling, place, heights, batch.borders)
    path = batch.folder / batch.output.name(zoom, row, col)
    if tile is None:
        path.unlink(missing_ok=True)
        return TileRecord(zoom, row, col, 0, 0, 0, 0.0, 0.0, 0.0, key, rasters)
    content = batch.output.encode(zoom, tile, batch.largest_range)
    _write(path, content)
    sizes = len(content), len(tile.heights), len(tile.triangles)
    span = float(tile.heights.min()), float(tile.heights.max())
    return TileRecord(zoom, row, col, *sizes, tile.error, *span, key, rasters)


def _write(path: Path, content: bytes) -> None:
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)


def _remove_stale(
    folder: Path, table: sqlite3.Connection, levels: dict[int, Level], output: Format
) -> int:
    """Remove the tiles that a changed raster no longer has; return how many."""
    places = table.execute("SELECT zoom, row, col, n_bytes FROM tiles").fetchall()
    stale = [place for place in places if place[1:3] not in levels[place[0]].available]
    for zoom, row, col, _ in stale:
        (folder / output.name(zoom, row, col)).unlink(missing_ok=True)
    with table:
        wanted = "DELETE FROM tiles WHERE zoom = ? AND row = ? AND col = ?"
        table.executemany(wanted, [place[:3] for place in stale])
    return sum(place[3] > 0 for place in stale)


def _remove_unknown(
    folder: Path,
    table: sqlite3.Connection,
    levels: dict[int, Level],
    output: Format,
    index: set[str],
) -> None:
    """Remove files named like tiles that are none: of an ended run, or led to by an old index."""
    for zoom in levels:
        drawn = (record for record in _records(table, zoom) if record.n_bytes > 0)
        names = index.union(output.name(zoom, record.row, record.col) for record in drawn)
        for path in folder.glob(f"{zoom}/*/*"):
            is_known = path.relative_to(folder).as_posix() in names
            if not is_known and path.stem.isdigit() and path.parent.name.isdigit():
                path.unlink()


def _summaries(
    table: sqlite3.Connection, plan: Plan, levels: dict[int, Level], output: Format
) -> list[LevelSummary]:
    figures = table.execute(
        "SELECT zoom, max(error), sum(n_bytes > 0), sum(n_vertices), sum(n_triangles), sum(n_bytes)"
        " FROM tiles GROUP BY zoom ORDER BY zoom"
    )
    return [
        LevelSummary(
            zoom,
            plan.tolerances[zoom],
            error + output.rounding(zoom, levels[zoom].settled.largest_range),
            *counts,
        )
        for zoom, error, *counts in figures
    ]


def _run(
    executor: Executor | None, function: Callable[[Any], Any], items: Iterable[Any]
) -> Iterator[Any]:
    """Yield ``function(item)`` for each item, as they are done; few items are held at a time."""
    if executor is None:
        yield from map(function, items)
        return
    waiting = iter(items)
    running: set[Future[Any]] = {
        executor.submit(function, item) for item in islice(waiting, _MOST_IN_FLIGHT)
    }
    try:
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
            running |= {executor.submit(function, item) for item in islice(waiting, len(done))}
    finally:
        for future in running:
            future.cancel()
