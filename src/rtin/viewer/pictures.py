"""Pictures and films of terrain, drawn by VTK without a screen."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from rtin._atomic import replacing, require_place
from rtin._number import as_number, as_positive
from rtin._options import as_exaggeration, require_word
from rtin.grid import Grid
from rtin.mesh import TriangleMesh
from rtin.viewer._offscreen import require_renderer
from rtin.viewer.cameras import overlook
from rtin.viewer.colours import Drape, hillshade
from rtin.viewer.opening import mesh_in_metres
from rtin.viewer.scene import (
    HORIZON,
    LIFT,
    SKY,
    Mode,
    Settings,
    Shown,
    Terrain,
    View,
    usual_painters,
)

__all__ = [
    "as_terrain",
    "film_size",
    "picture",
    "record",
    "require_film_path",
    "require_size",
    "require_still_path",
    "snapshot",
]

_Image = NDArray[np.uint8]
_Source = Grid | TriangleMesh | Terrain

SIZE = (1280, 720)
_LARGEST = 8192  # pixels a side
_STILLS = (".png", ".jpg", ".jpeg")
_FILMS = (".mp4", ".gif")
_FASTEST, _FASTEST_GIF = 1000.0, 50.0  # pictures a second; players slow faster GIFs down
_INK = (0.13, 0.15, 0.2)
_NEAR_EDGE = 1.0  # pixels: the width of edges


def picture(
    source: _Source,
    view: View | None = None,
    *,
    settings: Settings | None = None,
    size: tuple[int, int] = SIZE,
) -> _Image:
    """Return a picture of a terrain.

    Parameters
    ----------
    source : Grid, TriangleMesh or Terrain
        Degrees become metres round the middle, as in ``Grid.in_metres``. A grid's level of detail
        is made for each call: a ``Terrain`` keeps it.
    view : View, optional
        From where; from the south, above the whole terrain, by default. ``rtin.viewer.cameras`` has
        others. The height and aspect of the picture are those of ``size``.
    settings : Settings, optional
        How fine, which colours, and how much higher; see ``rtin.viewer.scene``.
    size : (int, int)
        Width and height in pixels.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        sRGB.

    Raises
    ------
    ImportError
        If pyvista is missing.
    OSError
        If there is nothing to draw with.
    TypeError, ValueError
        If the source, size or settings are wrong ones.
    """
    _require_kind("view", view, View)
    _require_kind("settings", settings, Settings)
    with _Stage(size) as stage:
        terrain, settings = as_terrain(source), settings or Settings()
        first = overlook(terrain, settings.exaggeration, size[0] / size[1])
        return stage.draw(terrain, view or first, settings)


def snapshot(
    source: _Source,
    path: str | os.PathLike[str],
    view: View | None = None,
    *,
    settings: Settings | None = None,
    size: tuple[int, int] = SIZE,
) -> None:
    """Write a picture of a terrain, as .png or .jpg; whole or not at all.

    Parameters and errors are those of ``picture``; ValueError for another extension, OSError where
    the file can't be written.
    """
    from PIL import Image

    require_still_path(path)
    image = Image.fromarray(picture(source, view, settings=settings, size=size))
    with replacing(path) as part:
        image.save(part)


def record(
    source: _Source | Iterable[_Source],
    path: str | os.PathLike[str],
    views: Iterable[View],
    *,
    settings: Settings | None = None,
    size: tuple[int, int] = SIZE,
    frames_per_second: float = 25.0,
    tell: Callable[[float], None] | None = None,
) -> None:
    """Write a film of a terrain, as .mp4 or .gif; whole or not at all.

    Parameters
    ----------
    source : Grid, TriangleMesh, Terrain, or an iterable of them
        What is seen: one terrain all the time, or another one in each view.
    path : path-like
    views : iterable of View
        One for each picture of the film.
    settings, size
        As for ``picture``; an .mp4 has even numbers of pixels, rounded down.
    frames_per_second : float
        At most 1000; 50 for a .gif, as players slow faster ones down.
    tell : function, optional
        Called after each picture with the share of them that is done.

    Raises
    ------
    ImportError
        If pyvista or imageio is missing.
    OSError
        If there is nothing to draw with, or the file can't be written.
    TypeError, ValueError
        As ``picture`` does; for another extension; if there is no view at all, or fewer terrains
        than views.
    """
    require_film_path(path)
    _require_rate(path, frames_per_second)
    size, views = film_size(path, size), list(views)
    if len(views) == 0:
        raise ValueError("a film needs at least one view, got none")
    for view in views:
        _require_kind("a view", view, View)
    _require_kind("settings", settings, Settings)
    settings, terrains = settings or Settings(), _one_each(source)
    with replacing(path) as part, _Stage(size) as stage, _film(part, frames_per_second) as film:
        for done, view in enumerate(views, 1):
            terrain = next(terrains, None)
            if terrain is None:
                raise ValueError(
                    f"there must be a terrain for each of the {len(views)} views, got {done - 1}"
                )
            film.append_data(stage.draw(terrain, view, settings))
            if tell is not None:
                tell(done / len(views))


def require_still_path(path: str | os.PathLike[str]) -> None:
    """Raise now what ``snapshot`` would raise because of ``path``."""
    _require_extension(path, _STILLS, "a picture")


def require_film_path(path: str | os.PathLike[str]) -> None:
    """Raise now what ``record`` would raise because of ``path``."""
    _require_extension(path, _FILMS, "a film")


def require_size(size: tuple[int, int]) -> None:
    """Raise now what ``picture`` would raise because of ``size``."""
    _as_size(size)


def film_size(path: str | os.PathLike[str], size: tuple[int, int]) -> tuple[int, int]:
    """Return the size of the film that ``record`` writes where ``size`` is asked for.

    Raises now what ``record`` would raise because of it.
    """
    width, height = _as_size(size)
    if Path(path).suffix.lower() != ".mp4":
        return width, height
    if min(width, height) < 2:
        raise ValueError(f"size must be at least 2 × 2 pixels for an .mp4, got {size!r}")
    return width // 2 * 2, height // 2 * 2


def require_something_to_draw_with() -> None:
    """Raise now what ``picture`` would raise because of what is not installed."""
    _pyvista()


def _pyvista() -> Any:  # noqa: ANN401  (pyvista is an extra)
    require_renderer()
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(f"pictures need pyvista ({error}): pip install 'rtin[view]'") from None
    return pyvista


def as_terrain(source: _Source) -> Terrain:
    """Return a terrain of a grid or mesh, with all colours that a page has."""
    if isinstance(source, Terrain):
        return source
    if isinstance(source, Grid):
        grid = source.in_metres()
        return Terrain(grid, painters=usual_painters(grid, hillshade(grid)))
    if isinstance(source, TriangleMesh):
        return Terrain(mesh_in_metres(source)[0])
    raise TypeError(f"a Grid, a TriangleMesh or a Terrain is wanted, got {type(source).__name__}")


def _require_possible(settings: Settings, terrain: Terrain) -> None:
    """Refuse settings that nobody can choose on the page.

    The colours that nobody chose may be those of any terrain: the first ones it has.
    """
    require_word("mode", settings.mode, get_args(Mode))
    if settings.colours != Settings.colours:
        require_word("colours", settings.colours, terrain.painters)
    for name in ("pixel_error", "max_triangles"):
        as_positive(name, getattr(settings, name))
    as_exaggeration(settings.exaggeration)


class _Stage:
    """A window of VTK that nobody sees; a context, which ends it."""

    def __init__(self, size: tuple[int, int]) -> None:
        width, height = _as_size(size)
        self._size = (width, height)
        self._pyvista = _pyvista()
        self._drape: Drape | None = None
        self._its_texture: Any = None
        self._plotter: Any = self._pyvista.Plotter(off_screen=True, window_size=[width, height])
        self._plotter.set_background(HORIZON, top=SKY)
        self._plotter.enable_anti_aliasing("ssaa")

    def draw(self, terrain: Terrain, view: View, settings: Settings) -> _Image:
        _require_possible(settings, terrain)
        width, height = self._size
        view = View(view.eye, view.target, view.up, view.field_of_view, height, width / height)
        plotter = self._plotter
        plotter.clear_actors()
        lift = LIFT * float(np.linalg.norm(np.subtract(view.eye, view.target)))
        self._put(terrain.shown(view, settings), lift)
        camera = plotter.camera
        camera.position, camera.focal_point, camera.up = view.eye, view.target, view.up
        camera.view_angle = view.field_of_view
        plotter.reset_camera_clipping_range()
        plotter.render()
        return np.ascontiguousarray(plotter.screenshot(None, return_img=True)[:, :, :3])

    def _put(self, shown: Shown, lift: float) -> None:
        if shown.mesh.n_triangles == 0:
            return
        # Drawn when all is there, rather than after each part of it.
        unlit: dict[str, Any] = {"lighting": False, "render": False, "reset_camera": False}
        surface = self._pyvista.PolyData.from_regular_faces(shown.vertices, shown.mesh.triangles)
        if isinstance(shown.painter, Drape):
            drape = shown.painter
            uv = drape.texture_coordinates(shown.mesh.vertices)
            uv[:, 1] = 1.0 - uv[:, 1]  # VTK has v from below
            surface.active_texture_coordinates = uv
            self._plotter.add_mesh(surface, texture=self._texture(drape), **unlit)
        else:
            colours = shown.painter(shown.mesh).clip(0.0, 1.0)
            rgb = np.rint(255.0 * colours).astype(np.uint8)
            self._plotter.add_mesh(surface, scalars=rgb, rgb=True, **unlit)
        if shown.edges is not None:
            lines = np.column_stack([np.full(len(shown.edges), 2), shown.edges]).ravel()
            above = shown.vertices + np.array([0.0, 0.0, lift])
            net = self._pyvista.PolyData(above, lines=lines)
            self._plotter.add_mesh(net, color=_INK, line_width=_NEAR_EDGE, **unlit)

    def _texture(self, drape: Drape) -> Any:  # noqa: ANN401  (pyvista is an extra)
        """Return the texture of a drape, made once for a film."""
        if self._drape is not drape:
            self._drape = drape
            self._its_texture = self._pyvista.Texture(drape.image)
            self._its_texture.mipmap = self._its_texture.interpolate = True
        return self._its_texture

    def __enter__(self) -> _Stage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._plotter.close()


def _require_kind(name: str, value: object, kind: type) -> None:
    if value is not None and not isinstance(value, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, got {type(value).__name__}")


def _require_rate(path: str | os.PathLike[str], frames_per_second: float) -> None:
    most = _FASTEST_GIF if Path(path).suffix.lower() == ".gif" else _FASTEST
    if not 0.0 < as_number("frames_per_second", frames_per_second) <= most:
        raise ValueError(
            f"frames_per_second must be more than zero and at most {most:g} for "
            f"{os.fspath(path)}, got {frames_per_second!r}"
        )


def _film(path: Path, frames_per_second: float) -> Any:  # noqa: ANN401  (imageio is an extra)
    is_gif = path.suffix.lower() == ".gif"
    try:
        import imageio

        if not is_gif:
            import_module("imageio_ffmpeg")  # imageio tells of it in its own way, at length
    except ImportError as error:
        raise ImportError(f"films need imageio ({error}): pip install 'rtin[view]'") from None
    if is_gif:
        return imageio.get_writer(path, duration=1000.0 / frames_per_second, loop=0)
    options: dict[str, Any] = {"macro_block_size": 2, "quality": 8, "ffmpeg_log_level": "error"}
    return imageio.get_writer(path, fps=frames_per_second, **options)


def _one_each(source: _Source | Iterable[_Source]) -> Iterator[Terrain]:
    if isinstance(source, Grid | TriangleMesh | Terrain):
        terrain = as_terrain(source)
        while True:
            yield terrain
    for one in source:
        yield as_terrain(one)


def _require_extension(
    path: str | os.PathLike[str], extensions: tuple[str, ...], what: str
) -> None:
    suffix = Path(path).suffix.lower()
    if suffix not in extensions:
        wanted = ", ".join(extensions)
        raise ValueError(f"{what} must end in one of {wanted}; got {os.fspath(path)}")
    require_place(path)


def _as_size(size: tuple[int, int]) -> tuple[int, int]:
    shape = np.asarray(size)
    if shape.shape != (2,) or shape.dtype.kind not in "iu" or not (shape > 0).all():
        raise ValueError(f"size must be width and height in whole pixels, got {size!r}")
    if shape.max() > _LARGEST:
        raise ValueError(f"size must be at most {_LARGEST} pixels a side, got {size!r}")
    width, height = shape.tolist()
    return width, height
