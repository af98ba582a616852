"""The command ``rtin view``."""

from __future__ import annotations

import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rtin._console import (
    Band,
    Encoding,
    announce,
    one_line,
    one_line_errors,
    progress,
    say,
    say_if_not_compiled,
)

if TYPE_CHECKING:
    from rtin.viewer.opening import Opened
    from rtin.viewer.scene import Place, Settings, Terrain

__all__ = ["view"]


def view(
    path: Annotated[
        Path, typer.Argument(metavar="DEM|MESH", help="A raster, or a mesh that rtin reads.")
    ],
    pixel_error: Annotated[
        float, typer.Option(metavar="PIXELS", help="How far off a sample may be on the screen.")
    ] = 1.0,
    max_triangles: Annotated[
        int | None, typer.Option(metavar="N", help="A budget for each picture, instead.")
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(metavar="HEIGHT", help="A tolerance that holds everywhere, instead."),
    ] = None,
    exaggeration: Annotated[float, typer.Option(metavar="TIMES", help="Heights times this.")] = 1.0,
    photo: Annotated[
        Path | None,
        typer.Option("--orthophoto", metavar="IMAGE", help="Lay a picture over the terrain."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0: all.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any that is free.")] = 8080,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only say where the page is.")
    ] = False,
    band: Band = 1,
    encoding: Encoding = None,
) -> None:
    """Look at a raster or a mesh in the browser; the level of detail follows the camera."""
    with one_line_errors(), ExitStack() as stack:
        from rtin.viewer.opening import Opening
        from rtin.viewer.page import Page, run

        settings = _settings(
            pixel_error,
            max_triangles,
            max_error,
            exaggeration,
            "hillshade" if photo is None else "orthophoto",
        )
        with progress(f"opening {path.name}"):
            opening = stack.enter_context(Opening(path, band=band, encoding=encoding))
            first = opening.first()
        say_if_not_compiled("rtin.lod")
        with progress(f"preparing {path.name}"):
            terrain = _terrain(first, photo)
        page = stack.enter_context(Page(terrain, host, port, settings=settings, title=path.name))
        opening.go_on(
            lambda finer: page.replace(_terrain(finer, photo, terrain.place)),
            lambda error: say(f"the rest of {path.name} is not shown: {one_line(error)}"),
        )
        if not no_browser:
            webbrowser.open(page.address)
        run(page, say=announce)


def _terrain(opened: Opened, photo: Path | None, place: Place | None = None) -> Terrain:
    from rtin.viewer.scene import Terrain, painters_of

    painters = painters_of(opened, photo)
    return Terrain(opened.surface, place=place, painters=painters, note=opened.note)


def _settings(
    pixel_error: float,
    max_triangles: int | None,
    max_error: float | None,
    exaggeration: float,
    colours: str,
) -> Settings:
    """Return what clients begin with; refuse what no mesh can be asked for."""
    from rtin.viewer.scene import Settings

    if max_triangles is not None and max_error is not None:
        raise typer.BadParameter("give --max-triangles or --max-error, not both")
    _require_more_than_zero("--pixel-error", pixel_error)
    _require_more_than_zero("--exaggeration", exaggeration)
    if max_error is not None and not 0.0 <= max_error < float("inf"):
        raise typer.BadParameter(f"--max-error must be zero or more, got {max_error}")
    common: dict[str, Any] = {
        "pixel_error": pixel_error,
        "exaggeration": exaggeration,
        "colours": colours,
    }
    if max_triangles is not None:
        _require_more_than_zero("--max-triangles", max_triangles)
        return Settings("triangle budget", max_triangles=max_triangles, **common)
    if max_error is not None:
        return Settings("tolerance", max_error=max_error, **common)
    return Settings(**common)


def _require_more_than_zero(flag: str, value: float) -> None:
    if not 0.0 < value < float("inf"):
        raise typer.BadParameter(f"{flag} must be more than zero, got {value}")
