"""The commands ``rtin info`` and ``rtin plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from rtin._commands._console import Json, one_line_errors, progress, report
from rtin._commands._surfaces import (
    Band,
    Encoding,
    EncodingName,
    Window,
    mesh_counts,
    name_of,
    read_raster,
)
from rtin._commands._usage import values_are_usage

__all__ = ["info", "plot"]


_MOST_TAGS = 20  # shown


def info(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A raster or a mesh.")],
    band: Band = 1,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Say what a raster or a mesh holds, and what is odd."""
    with one_line_errors():
        from rtin.io.meshes import is_mesh_path

        summary = _mesh_info(path) if is_mesh_path(path) else _grid_info(path, band, encoding)
        report(summary, as_json)


def plot(
    path: Annotated[Path, typer.Argument(metavar="MESH", help="A mesh that rtin reads.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Picture: .png .jpg .svg .pdf.")],
    dem: Annotated[
        Path | None, typer.Option(metavar="DEM", help="Raster to shade below the mesh.")
    ] = None,
    band: Band = 1,
    window: Window = None,
    encoding: Encoding = None,
    as_json: Json = False,
) -> None:
    """Draw a mesh from above, over its raster's hillshade."""
    with one_line_errors():
        from rtin.io.meshes import read_mesh
        from rtin.plotting import require_picture_path, save_picture

        with values_are_usage():
            require_picture_path(out)
        with progress(f"reading {path}"):
            mesh = read_mesh(path)
        grid = None if dem is None else read_raster(dem, band, window, encoding)
        with progress(f"drawing {out}"):
            save_picture(mesh, out, grid=grid)
        report({"input": str(path), "output": str(out), **mesh_counts(mesh)}, as_json)


def _grid_info(path: Path, band: int, encoding: EncodingName | None) -> dict[str, Any]:
    import numpy as np

    from rtin.io.grids import suspicious_values

    grid = read_raster(path, band, None, encoding)
    rows, cols = grid.shape
    return {
        "input": str(path),
        "rows": rows,
        "cols": cols,
        "samples": grid.n_samples,
        "voids": rows * cols - grid.n_samples,
        "lowest": float(np.nanmin(grid.heights)),
        "highest": float(np.nanmax(grid.heights)),
        "type": str(grid.heights.dtype),
        "crs": name_of(grid.crs),
        "transform": list(grid.transform)[:6],
        "suspicious": suspicious_values(grid),
    }


def _mesh_info(path: Path) -> dict[str, Any]:
    from rtin.io.meshes import read_mesh
    from rtin.validity import complaints, is_closed

    with progress(f"reading {path}"):
        mesh = read_mesh(path)
    low, high = mesh.bounds
    solid = is_closed(mesh)
    return {
        "input": str(path),
        **mesh_counts(mesh),
        "from": low.tolist(),
        "to": high.tolist(),
        "crs": name_of(mesh.crs),
        "solid": solid,
        "tags": [] if mesh.tags is None else _counts_of_tags(mesh.tags),
        "complaints": [] if solid else complaints(mesh),
    }


def _counts_of_tags(tags: Any) -> list[str]:  # noqa: ANN401  (NumPy is imported where needed)
    """Return the commonest tags with their numbers of triangles."""
    import numpy as np

    found, counts = np.unique(tags, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:_MOST_TAGS]
    more = ["…"] if len(found) > _MOST_TAGS else []
    return [f"{found[i]} ({counts[i]} triangles)" for i in order] + more
