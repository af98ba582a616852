"""The command ``rtin view``."""

from __future__ import annotations

import math
import re
import webbrowser
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from rtin._commands._console import (
    announce,
    one_line,
    one_line_errors,
    progress,
    progress_bar,
    say,
    say_if_not_compiled,
)
from rtin._commands._surfaces import Band, Encoding
from rtin._commands._usage import require_positive, values_are_usage

if TYPE_CHECKING:
    from rtin.viewer.opening import Opened, Opening
    from rtin.viewer.page import Page
    from rtin.viewer.scene import Place, Settings, Terrain

__all__ = ["view"]


def view(
    path: Annotated[
        Path, typer.Argument(metavar="DEM|MESH", help="A raster, or a mesh that rtin reads.")
    ],
    pixel_error: Annotated[
        float | None,
        typer.Option(
            metavar="PIXELS", help="How far off a sample may be on the screen.  [default: 1.0]"
        ),
    ] = None,
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
    colours: Annotated[
        Literal["hillshade", "height", "error", "orthophoto"] | None,
        typer.Option(help="Of the terrain."),
    ] = None,
    wireframe: Annotated[bool, typer.Option("--wireframe", help="Draw the edges, too.")] = False,
    snapshot: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE", help="Write a .png or .jpg instead of serving a page."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILM", help="Write an .mp4 or .gif instead of serving a page."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Of pictures, in pixels.  [default: 1280x720]"),
    ] = None,
    eye: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Take the picture from there.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="What the eye looks at.")
    ] = None,
    path_of_film: Annotated[
        Literal["orbit", "flight"] | None,
        typer.Option("--path", help="Of the camera in a film.  [default: orbit]"),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Pictures of a film.  [default: 150]"),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen at; 0.0.0.0: all.  [default: 127.0.0.1]"),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="0: any that is free.  [default: 8080]"),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only say where the page is.")
    ] = False,
    band: Band = 1,
    encoding: Encoding = None,
) -> None:
    """Look at a raster or a mesh in the browser; the level of detail follows the camera.

    With --snapshot or --record, write a picture or a film instead: no screen is needed.
    """
    with one_line_errors(), ExitStack() as stack:
        from rtin.io.meshes import is_mesh_path
        from rtin.viewer.opening import Opening

        is_page = snapshot is None and record is None
        _require_use("--eye", eye, "--snapshot", snapshot is not None)
        _require_use("--target", target, "--snapshot", snapshot is not None)
        _require_use("--path", path_of_film, "--record", record is not None)
        _require_use("--frames", frames, "--record", record is not None)
        _require_use("--size", size, "--snapshot and --record", not is_page)
        for flag, value in {"--host": host, "--port": port, "--no-browser": no_browser}.items():
            _require_use(flag, value, "the page, not for --snapshot and --record", is_page)
        if colours == "orthophoto" and photo is None:
            raise typer.BadParameter("--colours orthophoto needs --orthophoto IMAGE")
        if is_mesh_path(path):
            given = {
                "--pixel-error": pixel_error is not None,
                "--max-triangles": max_triangles is not None,
                "--max-error": max_error is not None,
                "--colours error": colours == "error",
                "--band": band > 1,
                "--encoding": encoding is not None,
            }
            _require_none_for_a_mesh(path, given)
        usual = "hillshade" if photo is None else "orthophoto"
        settings = replace(
            _settings(pixel_error, max_triangles, max_error, exaggeration, colours or usual),
            wireframe=wireframe,
        )
        if not is_page:
            film = path_of_film or "orbit", frames or 150
            out = _Out(snapshot, record, _size(size or "1280x720"), _points(eye, target), *film)
            _require_possible(out)
            opening = stack.enter_context(Opening(path, band=band, encoding=encoding))
            _draw(opening, path.name, photo, settings, out)
            return
        from rtin.viewer.page import Page, run

        with progress(f"opening {path.name}"):
            opening = stack.enter_context(Opening(path, band=band, encoding=encoding))
            first = opening.first()
        terrain = _prepared(first, path.name, photo, exaggeration)
        listener = host or "127.0.0.1", 8080 if port is None else port
        page = stack.enter_context(Page(terrain, *listener, settings=settings, title=path.name))
        _go_on(opening, page, path.name, photo)
        if not no_browser:
            webbrowser.open(page.address)
        run(page, say=announce)


_Point = tuple[float, float, float]


class _Out(NamedTuple):
    """What is to be written: pictures and films, of which size, seen from where."""

    snapshot: Path | None
    record: Path | None
    size: tuple[int, int]
    points: tuple[_Point, _Point] | None
    path: Literal["orbit", "flight"]
    frames: int


def _require_possible(out: _Out) -> None:
    """Raise now what writing would raise because of paths, the size or what is not installed."""
    from rtin.viewer import pictures

    with values_are_usage():
        if out.snapshot is not None:
            pictures.require_still_path(out.snapshot)
            pictures.require_size(out.size)
        if out.record is not None:
            pictures.require_film_path(out.record)
            pictures.film_size(out.record, out.size)
    pictures.require_something_to_draw_with()


def _draw(opening: Opening, name: str, photo: Path | None, settings: Settings, out: _Out) -> None:
    """Write a picture, a film, or both, of all that there is."""
    from rtin.viewer import cameras, pictures

    with progress(f"opening {name}"):
        opened = opening.finest()
    terrain = _prepared(opened, name, photo, settings.exaggeration)
    place, higher = terrain.place, settings.exaggeration
    if out.snapshot is not None:
        view = cameras.overlook(terrain, higher, out.size[0] / out.size[1])
        if out.points is not None:
            eye, target = (opened.from_crs(point) for point in out.points)
            view = cameras.seen_from(place, eye, target, higher)
            if not cameras.is_in_sight(terrain, view, higher, out.size[0] / out.size[1]):
                say(f"nothing of {name} is in {out.snapshot}: it lies within {_within(opened)}")
        with progress(f"drawing {out.snapshot}"):
            pictures.snapshot(terrain, out.snapshot, view, settings=settings, size=out.size)
        announce(f"{out.snapshot}: {out.size[0]} × {out.size[1]} pixels")
    if out.record is not None:
        if out.path == "orbit":
            views = cameras.orbit(out.frames, terrain, higher, out.size[0] / out.size[1])
        else:
            views = cameras.flight(opened.surface, place, out.frames, higher)
        with progress_bar(f"drawing {out.record}") as tell:
            pictures.record(terrain, out.record, views, settings=settings, size=out.size, tell=tell)
        width, height = pictures.film_size(out.record, out.size)
        announce(f"{out.record}: {out.frames} pictures of {width} × {height} pixels")


def _go_on(opening: Opening, page: Page, name: str, photo: Path | None) -> None:
    """Have finer stages take the place of the first; say here and on the page if one fails."""
    place = page.terrain.place

    def give_up(error: Exception) -> None:
        reason = f"the rest of {name} is not shown: {one_line(error)}"
        say(reason)
        page.replace(page.terrain.noted(reason))

    opening.go_on(lambda finer: page.replace(_terrain(finer, photo, place)), give_up)


def _within(opened: Opened) -> str:
    """Return the bounds of a terrain, in its CRS."""
    corners = zip(opened.bounds.tolist(), opened.surface.bounds[:, 2].tolist(), strict=True)
    points = (opened.into_crs((x, y, z)) for (x, y), z in corners)
    return " to ".join(",".join(f"{value:.10g}" for value in point) for point in points)


def _require_use(flag: str, value: object, what_for: str, is_used: bool) -> None:
    """Refuse a flag that has been given and changes nothing."""
    if value is not None and value is not False and not is_used:
        raise typer.BadParameter(f"{flag} is for {what_for}")


def _require_none_for_a_mesh(path: Path, given: dict[str, bool]) -> None:
    """Refuse flags that say how to read or to coarsen a raster."""
    for flag, is_given in given.items():
        if is_given:
            raise typer.BadParameter(f"{flag} is for rasters; {path} is a mesh, shown as it is")


def _say_if_a_needle(name: str, terrain: Terrain, exaggeration: float) -> None:
    """Point out heights in another unit than x and y, as those of most tiles without a CRS."""
    width, depth, height = (terrain.bounds[1] - terrain.bounds[0]).tolist()
    wide = max(width, depth)
    if min(exaggeration, 1.0) * height > wide:  # not only by what was asked for
        say(
            f"{name}: heights range over {height:.4g}, x and y over {wide:.4g} at most; "
            f"are the units the same? --exaggeration {0.2 * wide / height:.1g} flattens it"
        )


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)[x×](\d+)", text)
    if not found:
        raise typer.BadParameter(f"--size must be width x height, such as 1280x720; got {text!r}")
    return int(found[1]), int(found[2])


def _points(eye: str | None, target: str | None) -> tuple[_Point, _Point] | None:
    """Return eye and target; None where neither is given."""
    if eye is None and target is None:
        return None
    if eye is None or target is None:
        raise typer.BadParameter("give both --eye and --target, or neither")
    points = _point("--eye", eye), _point("--target", target)
    if points[0] == points[1]:
        raise typer.BadParameter(f"--eye and --target must be two points, both are {eye}")
    return points


def _point(flag: str, text: str) -> _Point:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise typer.BadParameter(f"{flag} must be three numbers, x,y,z; got {text!r}")
    return x, y, z


def _prepared(opened: Opened, name: str, photo: Path | None, exaggeration: float) -> Terrain:
    """Return what is drawn first, and say on stderr what there is to say of it."""
    say_if_not_compiled("rtin.lod")
    with progress(f"preparing {name}"):
        terrain = _terrain(opened, photo)
    _say_if_a_needle(name, terrain, exaggeration)
    return terrain


def _terrain(opened: Opened, photo: Path | None, place: Place | None = None) -> Terrain:
    from rtin.viewer.scene import Terrain, painters_of

    painters = painters_of(opened, photo)
    return Terrain(opened.surface, place=place, painters=painters, note=opened.note)


def _settings(
    pixel_error: float | None,
    max_triangles: int | None,
    max_error: float | None,
    exaggeration: float,
    colours: str,
) -> Settings:
    """Return what clients begin with; refuse what no mesh can be asked for."""
    from rtin._options import as_exaggeration
    from rtin.viewer.scene import Settings

    if sum(chosen is not None for chosen in (pixel_error, max_triangles, max_error)) > 1:
        raise typer.BadParameter("give one of --pixel-error, --max-triangles and --max-error")
    require_positive("--pixel-error", pixel_error)
    if max_triangles is not None and max_triangles < 2:
        raise typer.BadParameter(f"--max-triangles must be at least 2, got {max_triangles}")
    with values_are_usage():
        as_exaggeration(exaggeration)
    if max_error is not None and not 0.0 <= max_error < float("inf"):
        raise typer.BadParameter(f"--max-error must be zero or more, got {max_error}")
    common: dict[str, Any] = {
        "pixel_error": Settings.pixel_error if pixel_error is None else pixel_error,
        "exaggeration": exaggeration,
        "colours": colours,
    }
    if max_triangles is not None:
        return Settings("triangle budget", max_triangles=max_triangles, **common)
    if max_error is not None:
        return Settings("tolerance", max_error=max_error, **common)
    return Settings(**common)
