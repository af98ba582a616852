"""Rasters in: every format that GDAL reads, NumPy's .npy, and heights coded in a tile's colours."""

from __future__ import annotations

import logging
import os
import re
import threading
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from rtin._crs import as_crs
from rtin._raster import NORTH_UP, moved, row_chunks, scaled, widened
from rtin.grid import Grid
from rtin.io._thinning import Thinned

if TYPE_CHECKING:
    import pyproj
    from rasterio.windows import Window

    Part = tuple[tuple[int, int], tuple[int, int]]
    Heights = NDArray[np.floating[Any]]

__all__ = ["FillValues", "available_memory", "read_grid", "suspicious_values"]

# Both codes are linear in the 24-bit number 65536 R + 256 G + B, so each is a scale and an offset.
_SCALE_AND_OFFSET = {"terrain-rgb": (0.1, -10000.0), "terrarium": (1.0 / 256.0, -32768.0)}
_LOWEST_ON_EARTH, _HIGHEST_ON_EARTH = -12000.0, 9000.0
_FILL_VALUES = (-999, 9999, -9999, -10000, -32767, 32767, -32768, 65535, -99999, 99999)
_LARGEST_HEIGHT = 1e9
_MOST_LINES = 6  # of heights that look like nodata
_LARGEST_EXACT_INTEGER = 2.0**53
_OPENING = threading.Lock()  # warnings.catch_warnings is not for several threads at once
_RAW_DRIVERS = ("ENVI", "EHdr", "ISCE")
_GDAL_OPTIONS = {
    # Without these GDAL fills the missing end of a cut PNG with stale memory, and that of a raw
    # file, even if all of it is missing, with zeros.
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",
    "RAW_CHECK_FILE_SIZE": "YES",
}


def read_grid(
    path: str | os.PathLike[str],
    *,
    window: Window | tuple[tuple[int, int], tuple[int, int]] | None = None,
    band: int = 1,
    encoding: Literal["terrain-rgb", "terrarium", "none"] | None = None,
    step: int = 1,
) -> Grid:
    """Return the grid of heights in a raster file.

    A sample is void where the band's nodata value, its mask band, an alpha band or NaN says so: any
    of them is enough. The band's scale and offset are applied. A sample lies at the centre of its
    cell, whether the file says pixel-is-area or pixel-is-point; rows keep the file's order. Where a
    raster has no affine georeference, x is the column and y minus the row, as in ``Grid``.

    Parameters
    ----------
    path : path
        Any raster that GDAL reads (GeoTIFF and COG, .hgt, .asc, .dem, VRT, NetCDF, PNG, …), also as
        a GDAL name such as ``netcdf:file.nc:height``, or a two-dimensional ``.npy`` array.
    window : rasterio.windows.Window or ((row_start, row_stop), (col_start, col_stop)), optional
        The part to read, in whole samples and inside the raster. By default all of it.
    band : int
        Number of the band that holds the heights, from 1.
    encoding : {"terrain-rgb", "terrarium", "none"}, optional
        How a raster of colours (three or four bands of uint8, or a palette) holds heights:
        ``65536 R + 256 G + B`` times 0.1, minus 10000 (Mapbox), or divided by 256, minus 32768
        (Mapzen). ``"none"`` reads one band as it is. By default the code is the one whose heights
        exist on Earth, -12 000 to 9000 m, in every sample; a picture has none and is refused.
    step : int
        Take every ``step``-th row and column only, from the first one on: the same samples as
        ``heights[::step, ::step]`` of what is read without it, in a fraction of the memory, and of
        the time where whole blocks of the file are passed over. The file's overviews, whose heights
        are no samples, are not used.

    Returns
    -------
    Grid
        Heights in the file's unit. They are exact, float32 where that holds them and float64
        otherwise, except scaled and coded ones, which are rounded to float32 (0.0002 m at 4000 m).

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    OSError
        If the file is a directory, not a raster, truncated or damaged. GDAL does not notice every
        damage: a short PCIDSK or GeoPackage file and an XYZ table may be read as if complete.
    ValueError
        If the band does not exist, the window leaves the raster, the file holds several rasters,
        colours cannot be told to be heights, the step is less than 1 or leaves fewer than 2 × 2
        samples, or ``Grid`` refuses the heights.
    TypeError
        If the heights are not real numbers, or band or step are not whole numbers.
    MemoryError
        If the part to read is larger than the available memory.

    Warns
    -----
    UserWarning
        If the CRS is one that pyproj does not know, or only ground control points say where the
        raster lies; the grid then has no CRS.
    """
    name = os.fsdecode(path)
    check_choice(band, encoding)
    step = _as_step(step)
    read = _read_npy if is_npy(name) else _read_raster
    heights, transform, crs = read(name, window, int(band), encoding, step)
    try:
        return Grid(heights, transform, crs)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name}: {error}") from None


def is_npy(name: str) -> bool:
    """Return whether a file is read as NumPy's, by its name."""
    return name.lower().endswith(".npy")


def check_choice(band: object, encoding: object) -> None:
    """Raise TypeError or ValueError unless these can be a band's number and an encoding."""
    if encoding not in (None, "none", *_SCALE_AND_OFFSET):
        raise ValueError(
            f"encoding must be 'terrain-rgb', 'terrarium', 'none' or None, got {encoding!r}"
        )
    _require_whole("band", band)


def _as_step(step: object) -> int:
    _require_whole("step", step)
    if step < 1:  # type: ignore[operator]
        raise ValueError(f"step must be a whole number from 1, got {step}")
    return int(step)  # type: ignore[call-overload,no-any-return]


def _require_whole(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be a whole number from 1, got {_one_line(repr(value))}")


def suspicious_values(grid: Grid) -> list[str]:
    """Return one line for each extreme height that looks like a nodata value nobody declared.

    Looks only at the lowest and the highest heights, where fill values stand: the usual numbers
    (-9999, -32768, …) and everything beyond 1e9. A true height may be among them.
    """
    seen = FillValues()
    seen.look(grid.heights)
    return seen.lines()


class FillValues:
    """What ``suspicious_values`` looks for, in a raster seen part by part."""

    def __init__(self) -> None:
        self._counts: Counter[float] = Counter()
        self._others: set[float] = set()  # the lowest and highest of the rest of each part

    def look(self, heights: Heights) -> None:
        """Look at some more heights."""
        inside = ~np.isnan(heights)
        lowest, highest = _ends(heights, inside)
        if _look_like_fill(np.array([lowest, highest])).any():
            are_fills = _look_like_fill(heights)
            lowest, highest = _ends(heights, inside & ~are_fills)
            are_outside = are_fills & ((heights < lowest) | (heights > highest))
            values, counts = np.unique(heights[are_outside], return_counts=True)
            self._counts.update(dict(zip(values.tolist(), counts.tolist(), strict=True)))
        if lowest <= highest:
            self._others |= {lowest, highest}

    def lines(self) -> list[str]:
        """Return one line for each extreme height that looks like a nodata value.

        Of more than a few there are the most frequent ones, and a line that counts the rest.
        """
        lowest, highest = min(self._others, default=np.inf), max(self._others, default=-np.inf)
        counts = {
            value: count
            for value, count in self._counts.items()
            if value < lowest or value > highest
        }
        most = sorted(counts, key=lambda value: (-counts[value], value))[:_MOST_LINES]
        lines = [
            f"{value:.7g} in {counts[value]} samples: undeclared nodata?" for value in sorted(most)
        ]
        if len(most) < len(counts):
            lines.append(f"{len(counts) - len(most):,} more such heights")
        return lines


def _ends(heights: Heights, where: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the lowest and the highest height; infinity and minus infinity where there is none."""
    lowest = float(heights.min(where=where, initial=np.inf))
    return lowest, float(heights.max(where=where, initial=-np.inf))


def _look_like_fill(heights: Heights) -> NDArray[np.bool_]:
    is_large = np.abs(heights) >= _LARGEST_HEIGHT
    return np.asarray(is_large | np.isin(heights, list(_FILL_VALUES)))


def _read_npy(
    name: str, window: object, band: int, encoding: str | None, step: int
) -> tuple[NDArray[Any], Affine, None]:
    array = open_npy(name, band, encoding)
    thinned = Thinned(array, _part(window, array.shape, name), step)
    _require_memory(thinned.whole, array.dtype.itemsize + 8, name)
    rows, cols = thinned.slices
    transform = widened(moved(NORTH_UP, rows.start, cols.start), step)
    return np.array(array[rows, cols], order="C"), transform, None


def open_npy(name: str, band: int, encoding: str | None) -> NDArray[Any]:
    """Return the array of two dimensions in a .npy file, mapped into memory."""
    if band != 1 or encoding in _SCALE_AND_OFFSET:
        raise ValueError(
            f"{name}: a .npy array is one band of plain heights, "
            f"got band={band!r} and encoding={encoding!r}; leave both out"
        )
    try:
        array: NDArray[Any] = np.lib.format.open_memmap(name, mode="r")
    except Exception as error:  # numpy's parser of the header lets anything through
        raise _unreadable(name, error) from None
    if array.ndim != 2:
        raise ValueError(f"{name}: an array with two dimensions is wanted, got shape {array.shape}")
    return array


def _read_raster(
    name: str, window: object, band: int, encoding: str | None, step: int
) -> tuple[Heights, Affine, pyproj.CRS | None]:
    with opened(name) as dataset:
        _require_one_raster(dataset, name)
        part = _part(window, dataset.shape, name)
        if step == 1:
            heights = read_heights(dataset, name, part, band, encoding)
        else:
            thinned = Thinned(dataset, part, step)
            heights = read_heights(thinned, name, thinned.whole, band, encoding)
        transform = widened(_transform(dataset, name, part), step)
        return heights, transform, _crs(dataset, name)


def place_of(dataset: Any, name: str) -> tuple[Affine, pyproj.CRS | None]:  # noqa: ANN401
    """Return what maps (col, row) of an open raster's samples to (x, y), and its CRS."""
    _require_one_raster(dataset, name)
    return _transform(dataset, name, ((0, 1), (0, 1))), _crs(dataset, name)


def holds_codes(dataset: Any, encoding: str | None) -> bool:  # noqa: ANN401
    """Return whether an open raster is read as heights in the code of its colours."""
    return encoding != "none" and (encoding is not None or _is_coloured(dataset))


def read_heights(
    dataset: Any,  # noqa: ANN401
    name: str,
    part: Part,
    band: int,
    encoding: str | None,
) -> Heights:
    """Return the heights in rows and columns of an open raster, as ``read_grid`` describes them."""
    if holds_codes(dataset, encoding):
        return _read_colours(dataset, name, part, band, encoding)
    return _read_band(dataset, name, part, band)


def look_at(
    dataset: Any,  # noqa: ANN401
    name: str,
    band: int,
    encoding: str | None,
) -> tuple[Affine, pyproj.CRS | None, np.dtype[Any], str]:
    """Return transform, CRS, type and encoding of the heights that windows of a raster have.

    The type follows from the band's, not from its values. To recognise the encoding of colours, all
    of them are read, a part at a time.
    """
    _require_one_raster(dataset, name)
    if encoding is None:
        encoding = _encoding_of_all(dataset, name) if _is_coloured(dataset) else "none"
    corner = (0, 1), (0, 1)
    dtype = read_heights(dataset, name, corner, band, encoding).dtype
    return _transform(dataset, name, corner), _crs(dataset, name), dtype, encoding


def _encoding_of_all(dataset: Any, name: str) -> str:  # noqa: ANN401
    parts = [codes for rows in row_chunks(dataset.shape) for codes in [_extremes(dataset, rows)]]
    lowest, highest = np.transpose(parts)
    return _plausible_encoding(np.array([np.fmin.reduce(lowest), np.fmax.reduce(highest)]), name)


def _extremes(dataset: Any, rows: slice) -> tuple[float, float]:  # noqa: ANN401
    part = (rows.start, min(rows.stop, dataset.height)), (0, dataset.width)
    codes = _read_codes(dataset, part)
    return float(np.fmin.reduce(codes, axis=None)), float(np.fmax.reduce(codes, axis=None))


@contextmanager
def opened(name: str, overview: int | None = None) -> Iterator[Any]:
    """Open a raster, or one of its overviews, to read much of it at once."""
    # Two cores read a compressed GeoTIFF 1.7 times as fast as one.
    dataset = open_raster(name, n_threads="ALL_CPUS", overview=overview)
    with gdal_at_work(name), dataset:
        yield dataset


def open_raster(name: str, *, n_threads: str = "1", overview: int | None = None) -> Any:  # noqa: ANN401
    """Return rasterio's dataset, opened without a word on stderr, and checked to be whole.

    With one thread GDAL starts none of its own, which a forked process would wait for in vain.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

    options = {**_GDAL_OPTIONS, "GDAL_NUM_THREADS": n_threads}
    with _os_errors(name), _OPENING, warnings.catch_warnings(), rasterio.Env(**options):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with _cut_tags() as cut:
            level = {} if overview is None else {"overview_level": overview}
            dataset = rasterio.open(name, **level)
        if cut or _is_short_raw_file(dataset):
            dataset.close()
            raise RasterioIOError(cut[0] if cut else "the file is too small")
    return dataset


@contextmanager
def gdal_at_work(name: str) -> Iterator[None]:
    """Set GDAL's options for reading an open raster, and raise its failures as OSError."""
    import rasterio

    # A GeoTIFF takes its threads when opened. Those that other drivers (JPEG 2000) would start
    # later print their errors on stderr.
    with _os_errors(name), rasterio.Env(**{**_GDAL_OPTIONS, "GDAL_NUM_THREADS": "1"}):
        yield


@contextmanager
def _os_errors(name: str) -> Iterator[None]:
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import CRSError, RasterioError

    try:
        yield
    except (RasterioError, CPLE_BaseError, CRSError, UnicodeError) as error:
        raise _unreadable(name, error) from None


@contextmanager
def _cut_tags() -> Iterator[list[str]]:
    """Collect what GDAL only logs: tags, such as the georeference, beyond the end of a cut TIFF."""
    found: list[str] = []
    thread = threading.get_ident()

    def collect(record: logging.LogRecord) -> bool:
        if record.thread == thread and "IO error during reading" in record.getMessage():
            found.append(record.getMessage())
        return True

    logger = logging.getLogger("rasterio._env")
    logger.addFilter(collect)
    try:
        yield found
    finally:
        logger.removeFilter(collect)


def _is_short_raw_file(dataset: Any) -> bool:  # noqa: ANN401
    """Return whether a file of bare samples ends too soon: GDAL reads up to half as zeros."""
    if dataset.driver not in _RAW_DRIVERS or not Path(dataset.files[0]).is_file():
        return False
    header = dataset.tags(ns="ENVI")
    if header.get("file_compression") == "1" or "NBITS" in dataset.tags(1, ns="IMAGE_STRUCTURE"):
        return False
    bytes_per_cell = sum(np.dtype(dtype).itemsize for dtype in dataset.dtypes)
    n_bytes: int = dataset.height * dataset.width * bytes_per_cell
    return Path(dataset.files[0]).stat().st_size < n_bytes + int(header.get("header_offset", 0))


def _unreadable(name: str, error: Exception) -> OSError:
    goes_to_gdal = re.match(r"/vsi|\w\w+:", name)
    if not goes_to_gdal and not Path(name).exists():
        return FileNotFoundError(f"{name}: no such file")
    if not goes_to_gdal and Path(name).is_dir():
        return IsADirectoryError(f"{name} is a directory; the path of a raster file is wanted")
    reason = _one_line(error.__cause__ or error).removeprefix(f"'{name}' ")
    return OSError(f"{name} cannot be read as a raster, is it damaged or of another kind? {reason}")


def _one_line(value: object) -> str:
    return " ".join(str(value).split())


def _require_one_raster(dataset: Any, name: str) -> None:  # noqa: ANN401  (rasterio has no types)
    if dataset.count:
        return
    names = ", ".join(dataset.subdatasets)
    if not names:
        raise ValueError(f"{name}: a raster with at least one band is wanted, got none")
    raise ValueError(f"{name} holds several rasters; pass the name of one as the path: {names}")


def _part(window: Any, shape: tuple[int, ...], name: str) -> Part:  # noqa: ANN401
    """Return the rows and columns of a window, checked against the raster."""
    rows, cols = shape
    if window is None:
        return (0, rows), (0, cols)
    try:
        row_range, col_range = window.toranges() if hasattr(window, "toranges") else window
        row_start, row_stop = map(_whole, row_range)
        col_start, col_stop = map(_whole, col_range)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            "window must be a rasterio Window or ((row_start, row_stop), (col_start, col_stop)) "
            f"in whole samples, got {_one_line(window)}"
        ) from None
    if not (0 <= row_start < row_stop <= rows and 0 <= col_start < col_stop <= cols):
        raise ValueError(
            f"{name}: the window, rows {row_start} to {row_stop} and columns {col_start} to "
            f"{col_stop}, must lie inside the raster of {rows} rows and {cols} columns"
        )
    return (row_start, row_stop), (col_start, col_stop)


def _whole(value: Any) -> int:  # noqa: ANN401
    if int(value) != value:
        raise ValueError(value)
    return int(value)


def _require_memory(part: Part, bytes_per_sample: int, name: str) -> None:
    rows, cols = (stop - start for start, stop in part)
    needed, available = rows * cols * bytes_per_sample, available_memory()
    if available is not None and needed > available:
        raise MemoryError(
            f"{name}: {rows} rows of {cols} samples need {needed / 1e9:.1f} GB of memory, "
            f"{available / 1e9:.1f} GB are available; read a part of the raster with window="
        )


def available_memory() -> int | None:
    """Return the bytes of memory one can still take, None where the system does not tell."""
    # sysconf's free pages leave out what the file cache would give back, hence Linux's own figure.
    with suppress(OSError):
        found = re.search(r"MemAvailable:\s*(\d+) kB", Path("/proc/meminfo").read_text())
        if found:
            return int(found[1]) * 1024
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _read_band(dataset: Any, name: str, part: Part, band: int) -> Heights:  # noqa: ANN401
    if band not in dataset.indexes:
        raise ValueError(f"{name}: band must be from 1 to {dataset.count}, got {band!r}")
    dtype = np.dtype(dataset.dtypes[band - 1])
    if dtype.kind not in "fiu":
        raise TypeError(f"{name}: heights must be real numbers, band {band} holds {dtype}")
    float32_is_exact = dtype == np.float32 or dtype.itemsize <= 2
    _require_memory(part, 4 + 1 if float32_is_exact else 8 + 4 + 1, name)
    values = dataset.read(band, window=part, out_dtype="float32" if float32_is_exact else "float64")
    _make_void(values, dataset.nodatavals[band - 1], _hidden(dataset, part, band))
    if dtype.kind in "iu" and dtype.itemsize == 8:
        _require_exact(values, name)
    out = values if values.dtype == np.float32 else None
    return scaled(values, dataset.scales[band - 1], dataset.offsets[band - 1], out=out)


def _require_exact(values: Heights, name: str) -> None:
    largest = np.fmax.reduce(np.abs(values), axis=None)
    if largest >= _LARGEST_EXACT_INTEGER:
        raise ValueError(
            f"{name}: heights must be less than 2**53 to fit float64, got {largest:.4g}; "
            "subtract an offset or declare it as nodata"
        )


def _hidden(dataset: Any, part: Part, band: int) -> NDArray[np.bool_] | None:  # noqa: ANN401
    """Return where a mask band or an alpha band hides the samples, None if there is neither.

    GDAL's own masked reading takes one of mask, nodata and alpha and forgets the others.
    """
    from rasterio.enums import ColorInterp, MaskFlags

    flags = dataset.mask_flag_enums[band - 1]
    hidden = []
    if not flags or MaskFlags.per_dataset in flags:
        hidden.append(dataset.read_masks(band, window=part) == 0)
    for other, meaning in enumerate(dataset.colorinterp, start=1):
        if meaning == ColorInterp.alpha and other != band:
            hidden.append(dataset.read(other, window=part) == 0)
    return np.logical_or.reduce(hidden) if hidden else None


def _make_void(values: Heights, nodata: float | None, hidden: NDArray[np.bool_] | None) -> None:
    """Set to NaN, in place, the samples that hold ``nodata`` or are ``hidden``."""
    if hidden is not None:
        np.copyto(values, np.nan, where=hidden)
    if nodata is None or np.isnan(nodata):
        return
    for rows in row_chunks(values.shape):
        np.copyto(values[rows], np.nan, where=values[rows] == nodata)


def _is_coloured(dataset: Any) -> bool:  # noqa: ANN401
    bands = dataset.count
    return set(dataset.dtypes) == {"uint8"} and (bands in (3, 4) or _has_palette(dataset))


def _has_palette(dataset: Any) -> bool:  # noqa: ANN401
    from rasterio.enums import ColorInterp

    return dataset.count == 1 and bool(dataset.colorinterp[0] == ColorInterp.palette)


def _read_colours(
    dataset: Any,  # noqa: ANN401
    name: str,
    part: Part,
    band: int,
    encoding: str | None,
) -> Heights:
    if not _is_coloured(dataset):
        raise ValueError(
            f"{name}: encoding={encoding!r} needs three or four bands of uint8, "
            f"got {dataset.count} of {dataset.dtypes[0]}; leave the encoding out"
        )
    if band != 1:
        raise ValueError(
            f"{name}: a raster of colours is read as a whole, got band={band!r}; "
            "give the encoding 'none' to read one band of it as heights"
        )
    _require_memory(part, 4 + 3 + 2, name)
    codes = _read_codes(dataset, part)
    scale, offset = _SCALE_AND_OFFSET[encoding or _plausible_encoding(codes, name)]
    return scaled(codes, scale, offset, out=codes)


def _read_codes(dataset: Any, part: Part) -> NDArray[np.float32]:  # noqa: ANN401
    """Return ``65536 R + 256 G + B``, which float32 holds exactly; NaN where void."""
    codes = (_palette_codes if _has_palette(dataset) else _rgb_codes)(dataset, part)
    _make_void(codes, _nodata_code(dataset), _hidden(dataset, part, band=1))
    return codes


def _rgb_codes(dataset: Any, part: Part) -> NDArray[np.float32]:  # noqa: ANN401
    codes = np.zeros([stop - start for start, stop in part], np.float32)
    for colour in dataset.read((1, 2, 3), window=part):
        codes *= 256.0
        codes += colour
    return codes


def _palette_codes(dataset: Any, part: Part) -> NDArray[np.float32]:  # noqa: ANN401
    palette = np.full(256, np.nan, np.float32)
    for index, (red, green, blue, alpha) in dataset.colormap(1).items():
        if alpha and index != dataset.nodata:
            palette[index] = 65536 * red + 256 * green + blue
    indices: NDArray[np.uint8] = dataset.read(1, window=part)
    return palette[indices]


def _nodata_code(dataset: Any) -> float | None:  # noqa: ANN401
    """Return the code of the colour that is nodata in all three bands, if there is one."""
    nodata = dataset.nodatavals[:3]
    if len(nodata) < 3 or None in nodata:
        return None
    red, green, blue = nodata
    return float(65536 * red + 256 * green + blue)


def _plausible_encoding(codes: NDArray[np.floating[Any]], name: str) -> str:
    lowest = float(np.fmin.reduce(codes, axis=None))
    highest = float(np.fmax.reduce(codes, axis=None))
    plausible = [
        encoding
        for encoding, (scale, offset) in _SCALE_AND_OFFSET.items()
        if lowest * scale + offset >= _LOWEST_ON_EARTH
        and highest * scale + offset <= _HIGHEST_ON_EARTH
    ]
    if len(plausible) == 1:
        return plausible[0]
    raise ValueError(
        f"{name}: its colours are heights on Earth neither as terrain-RGB nor as Terrarium; "
        "give the encoding 'terrain-rgb' or 'terrarium' if they are, or 'none' to read one band "
        "as heights"
    )


def _transform(dataset: Any, name: str, part: Part) -> Affine:  # noqa: ANN401
    (row_start, _), (col_start, _) = part
    if dataset.transform != Affine.identity():
        return moved(dataset.transform, row_start + 0.5, col_start + 0.5)
    if dataset.gcps[0]:
        warnings.warn(
            f"{name} is placed by ground control points, which are left out: x is the column and "
            "y minus the row; gdalwarp gives such a raster a transform",
            stacklevel=4,
        )
    return moved(NORTH_UP, row_start, col_start)


def _crs(dataset: Any, name: str) -> pyproj.CRS | None:  # noqa: ANN401
    try:
        crs = dataset.crs
        return as_crs(crs.to_wkt(version="WKT2_2019")) if crs else None
    except ValueError as error:  # rasterio's CRSError is one, too
        warnings.warn(
            f"{name}: its CRS is left out, for pyproj does not know it: {_one_line(error)}",
            stacklevel=4,
        )
        return None
