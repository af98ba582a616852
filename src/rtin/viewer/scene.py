"""What the page draws: a terrain in small numbers round zero, cut for a view, as a GLB.

A scene's longer side is ``SIDE`` units, whatever the terrain's: viser's keys move 2 units a second,
and float32 vertices are good to a hundred-thousandth of a unit. z is up.
"""

from __future__ import annotations

import copy
import math
import os
import time
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtin import _tint
from rtin.grid import Grid
from rtin.io import _gltf
from rtin.lod import LevelOfDetail, frustum
from rtin.mesh import TriangleMesh
from rtin.viewer._film import BRIGHTNESS, before_film
from rtin.viewer.colours import (
    Drape,
    ErrorColours,
    Painter,
    by_error,
    by_height,
    hillshade,
    orthophoto,
)
from rtin.viewer.opening import Opened

__all__ = [
    "HORIZON",
    "LIFT",
    "MOST_TRIANGLES",
    "SIDE",
    "SKY",
    "Picture",
    "Place",
    "Settings",
    "Shown",
    "Terrain",
    "View",
    "painters_of",
    "usual_painters",
]

SIDE = 100.0  # units: the longer side of a terrain
_WIDER = 1.3  # than what is seen: a camera turns further before the next mesh is there
_WIDEST = 150.0  # degrees, unless a view itself is wider
LIFT = 5e-4  # of the distance looked over: edges lie above the triangles that they would cut
MOST_TRIANGLES = 500_000  # of a picture: 11 MB to send, and what a browser still turns smoothly
_SHADE = 0.3  # of the colour: what is left where no light falls
SKY, HORIZON = (185, 207, 228), (245, 243, 238)  # sRGB of what is behind, above and below
_INK = [0.02, 0.03, 0.05, 1.0]


_Floats = NDArray[np.float64]
Mode = Literal["pixel error", "triangle budget", "tolerance"]


@dataclass(frozen=True)
class Settings:
    """What somebody who looks at a page has chosen.

    ``mode`` says what counts: ``pixel_error`` in pixels or ``max_triangles`` for what the camera
    sees, or ``max_error`` in the heights' unit, everywhere; None takes as many
    triangles as the page draws.
    """

    mode: Mode = "pixel error"
    pixel_error: float = 1.0
    max_triangles: int = 100_000
    max_error: float | None = None
    wireframe: bool = False
    colours: str = "hillshade"
    exaggeration: float = 1.0


@dataclass(frozen=True)
class View:
    """A camera in the scene: eye, target and up of three floats, vertical angle in degrees.

    ``height`` is that of its picture in pixels, ``aspect`` its width by its height.
    """

    eye: tuple[float, ...]
    target: tuple[float, ...]
    up: tuple[float, ...] = (0.0, 0.0, 1.0)
    field_of_view: float = 60.0
    height: int = 1080
    aspect: float = 16.0 / 9.0


class Place(NamedTuple):
    """Where a terrain lies in the scene: the middle of its bounds, and units to one of its own."""

    middle: _Floats
    scale: float

    @classmethod
    def of(cls, bounds: _Floats) -> Place:
        """Return the place of a terrain within ``bounds``: least and largest x, y, z."""
        longer = float(np.ptp(bounds, axis=0)[:2].max())
        return cls(bounds.mean(axis=0), SIDE / (longer or 1.0))

    def into_scene(self, points: ArrayLike, exaggeration: float = 1.0) -> _Floats:
        """Return points of the world, shape (..., 3), in the scene."""
        return (np.asarray(points, np.float64) - self.middle) * self._scales(exaggeration)

    def into_world(self, points: ArrayLike, exaggeration: float = 1.0) -> _Floats:
        """Return points of the scene, shape (..., 3), in the world."""
        return np.asarray(points, np.float64) / self._scales(exaggeration) + self.middle

    def _scales(self, exaggeration: float) -> _Floats:
        return self.scale * np.array([1.0, 1.0, exaggeration])


class Picture(NamedTuple):
    """What a view shows: a GLB to send, how much it holds, and what it took.

    ``kept`` is the tolerance in pixels or in the heights' unit, None for a mesh from a file.
    ``is_cut_short`` where the one asked for takes more triangles than the page draws.
    """

    glb: bytes
    n_triangles: int
    n_vertices: int
    kept: float | None
    is_cut_short: bool
    mesh_seconds: float
    seconds: float


class Shown(NamedTuple):
    """A mesh, its vertices in the scene, what gives them colours, and edges to draw, if any."""

    mesh: TriangleMesh
    vertices: _Floats
    painter: Painter
    edges: NDArray[np.int64] | None


class Terrain:
    """A raster's level of detail or a mesh from a file, at its place in the scene.

    Any number of threads may draw it at once.

    Parameters
    ----------
    surface : Grid or TriangleMesh
        x, y and heights in one unit: a grid in degrees goes through ``Grid.in_metres`` before.
    place : Place, optional
        That of a terrain which this one takes the place of; its own by default.
    painters : dict of functions, optional
        By the names that ``Settings.colours`` may have: each returns sRGB colours in 0..1, shape
        (n, 3), for the vertices of a mesh. By default there are "hillshade", lit by the slopes of
        the mesh that is drawn, and "height".
    note : str
        What there is to be seen, in one line.

    Raises
    ------
    TypeError
        If ``surface`` is something else.
    """

    def __init__(
        self,
        surface: Grid | TriangleMesh,
        *,
        place: Place | None = None,
        painters: dict[str, Painter] | None = None,
        note: str = "",
    ) -> None:
        if not isinstance(surface, Grid | TriangleMesh):
            raise TypeError(f"a Grid or a TriangleMesh is wanted, got {type(surface).__name__}")
        self.note = note
        self.bounds = surface.bounds
        self.place = place or Place.of(self.bounds)
        self.painters = painters or usual_painters(surface, None)
        self._lod = LevelOfDetail(surface) if isinstance(surface, Grid) else None
        self._mesh = surface if isinstance(surface, TriangleMesh) else None

    def noted(self, note: str) -> Terrain:
        """Return the same terrain with another note."""
        other = copy.copy(self)
        other.note = note
        return other

    @property
    def has_levels(self) -> bool:
        """Whether there is a level of detail to choose."""
        return self._lod is not None

    @property
    def height_range(self) -> float:
        """How much the highest point lies above the lowest."""
        return float(np.ptp(self.bounds[:, 2]))

    def depends_on(self, view: View, settings: Settings) -> tuple[Any, ...]:
        """Return what a picture depends on: where it is equal, so is the picture."""
        if not self.has_levels or settings.mode == "tolerance":
            return (self, replace(settings, pixel_error=0.0, max_triangles=0))
        return (self, settings, view)

    def draw(self, view: View, settings: Settings) -> Picture:
        """Return what a view shows of the terrain, to send to a browser."""
        started = time.perf_counter()
        mesh, kept = self._cut(view, settings)
        is_cut_short = self.has_levels and mesh.n_triangles > MOST_TRIANGLES
        if is_cut_short:
            settings = _shorter(settings)
            mesh, kept = self._cut(view, settings)
        cut = time.perf_counter()
        shown = self._placed(mesh, kept, view, settings)
        lift = LIFT * float(np.linalg.norm(np.subtract(view.eye, view.target)))
        data = _glb(shown, lift)
        done = time.perf_counter()
        counts = (mesh.n_triangles, mesh.n_vertices)
        return Picture(data, *counts, kept, is_cut_short, cut - started, done - started)

    def shown(self, view: View, settings: Settings) -> Shown:
        """Return what a view shows of the terrain, however many triangles that takes."""
        return self._placed(*self._cut(view, settings), view, settings)

    def _placed(
        self, mesh: TriangleMesh, kept: float | None, view: View, settings: Settings
    ) -> Shown:
        paint = self.painters.get(settings.colours) or next(iter(self.painters.values()))
        vertices = self.place.into_scene(mesh.vertices, settings.exaggeration)
        edges = mesh.edges() if settings.wireframe else None
        if isinstance(paint, ErrorColours) and kept is not None:
            if settings.mode != "tolerance":
                distances = np.linalg.norm(vertices - view.eye, axis=1)
                height = self.place.scale * settings.exaggeration
                kept = kept * distances / (pixels_of(view) * height)
            paint = paint.within(kept)
        return Shown(mesh, vertices, paint, edges)

    def _cut(self, view: View, settings: Settings) -> tuple[TriangleMesh, float | None]:
        """Return the mesh of a view, and the tolerance that it keeps."""
        if self._lod is None:
            assert self._mesh is not None, "it is a grid or a mesh"
            return self._mesh, None
        if settings.mode == "tolerance":
            if settings.max_error is None:
                return self._lod.mesh(max_triangles=MOST_TRIANGLES), None
            return self._lod.mesh(max_error=settings.max_error), settings.max_error
        times = settings.exaggeration
        points = self.place.into_world([view.eye, view.target], times)
        eye, target = points * (1.0, 1.0, times)  # in the world as it is drawn
        angle = max(view.field_of_view, min(_WIDER * view.field_of_view, _WIDEST))
        planes = frustum(eye, target, field_of_view=angle, aspect=view.aspect, up=view.up)
        wanted: dict[str, Any] = {"pixel_error": settings.pixel_error}
        if settings.mode == "triangle budget":
            wanted = {"max_triangles": settings.max_triangles}
        frame = self._lod.frame(
            eye,
            **wanted,
            field_of_view=view.field_of_view,
            height=view.height,
            frustum=planes,
            exaggeration=times,
        )
        if frame.mesh.n_triangles == 0:  # there is none in sight, or none at all: that is raised
            return self._lod.mesh(max_error=math.inf), frame.pixel_error
        return frame.morphed, frame.pixel_error


def pixels_of(view: View) -> float:
    """Return the pixels of a length of 1 at a distance of 1, in the middle of a picture."""
    return view.height / (2.0 * math.tan(math.radians(view.field_of_view) / 2.0))


def _shorter(settings: Settings) -> Settings:
    """Return settings that give as many triangles as the page draws."""
    if settings.mode == "tolerance":
        return replace(settings, max_error=None)
    return replace(settings, mode="triangle budget", max_triangles=MOST_TRIANGLES)


def painters_of(opened: Opened, photo: str | os.PathLike[str] | None = None) -> dict[str, Painter]:
    """Return the painters of a terrain that has been opened, and one of a photograph over it.

    Those of a mesh from a file light it by its own slopes. Raises as ``orthophoto`` does.
    """
    surface = opened.surface
    under = hillshade(surface) if isinstance(surface, Grid) else None
    painters = usual_painters(surface, under)
    if photo is None:
        return painters
    return {"orthophoto": orthophoto(photo, opened, under=under), **painters}


def usual_painters(surface: Grid | TriangleMesh, relief: Drape | None) -> dict[str, Painter]:
    """Return a raster's painters, with its relief; or a mesh's, lit by its own slopes."""
    low, high = surface.bounds[:, 2].tolist()
    tinted = by_height(low, high)

    def lit(mesh: TriangleMesh) -> _Floats:
        light = _tint.hillshade(_normals(mesh))
        return np.asarray(tinted(mesh) * (_SHADE + light[:, np.newaxis]))

    if relief is None or isinstance(surface, TriangleMesh):
        return {"hillshade": lit, "height": tinted}
    return {"hillshade": relief, "height": tinted, "error": by_error(surface)}


def _normals(mesh: TriangleMesh) -> _Floats:
    corners = mesh.vertices[mesh.triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return _gltf.normals_of(crosses, mesh.triangles, mesh.n_vertices)


def _glb(shown: Shown, lift: float) -> bytes:
    """Return what is shown, unlit, and its edges so much above it, as a GLB.

    A drape goes along as a texture, which is sharp where triangles are large; what other painters
    give goes to the vertices. z is up, as viser has it within a GLB, too.
    """
    attributes: dict[str, NDArray[Any]] = {"POSITION": shown.vertices.astype("<f4")}
    drape = shown.painter if isinstance(shown.painter, Drape) else None
    if shown.edges is not None:
        attributes["edges"] = shown.edges.astype("<u4").ravel()
    if drape is None:
        attributes["COLOR_0"] = _sixteen_bits(before_film(shown.painter(shown.mesh)))
    else:
        uv = drape.texture_coordinates(shown.mesh.vertices)
        attributes["TEXCOORD_0"] = np.rint(65535.0 * uv).astype("<u2")
        attributes["jpeg"] = np.frombuffer(drape.jpeg + bytes(-len(drape.jpeg) % 4), np.uint8)

    def finish(tree: dict[str, Any]) -> None:
        tree["extensionsUsed"] = ["KHR_materials_unlit"]
        material = tree["materials"][0]
        material["extensions"] = {"KHR_materials_unlit": {}}
        # More than glTF allows in a file; three.js takes it.
        material["pbrMetallicRoughness"]["baseColorFactor"] = [BRIGHTNESS] * 3 + [1.0]
        if drape is not None:
            _gltf.lay_over(tree, "jpeg", len(drape.jpeg))
        if shown.edges is not None:
            _add_edges(tree, lift)

    return _gltf.packed(shown.mesh.triangles.astype("<u4"), attributes, finish)


def _sixteen_bits(colours: _Floats) -> NDArray[np.uint16]:
    """Return RGBA. Eight bits of linear light would show as steps in the shade."""
    rgba = np.full((len(colours), 4), 65535, "<u2")
    rgba[:, :3] = np.rint(65535.0 * colours.clip(0.0, 1.0))
    return rgba


def _add_edges(tree: dict[str, Any], lift: float) -> None:
    """Turn the attribute of edges into lines between the same vertices, in one dark colour."""
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    indices = attributes.pop("edges")
    tree["bufferViews"][indices]["target"] = tree["bufferViews"][0]["target"]
    lines = {"mode": 1, "attributes": {"POSITION": attributes["POSITION"]}, "indices": indices}
    tree["meshes"].append({"name": "edges", "primitives": [{**lines, "material": 1}]})
    ink = {"pbrMetallicRoughness": {"baseColorFactor": _INK}}
    tree["materials"].append({**ink, "extensions": {"KHR_materials_unlit": {}}})
    tree["nodes"].append({"name": "edges", "mesh": 1, "translation": [0.0, 0.0, lift]})
    tree["scenes"][0]["nodes"].append(1)
