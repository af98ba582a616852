"""A decoder of quantized-mesh 1.0, from its specification alone, that checks what it reads.

https://github.com/CesiumGS/quantized-mesh. Slow, plain and independent of the encoder.
"""

import struct
from types import SimpleNamespace

import numpy as np

LARGEST = 32767
RADII = np.array([6378137.0, 6378137.0, 6356752.314245179])
OCT_NORMALS = 1
N_CAMERAS = 50


class Reader:
    """Takes little-endian numbers one after another."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, kind, count):
        values = np.frombuffer(self.data, np.dtype(kind).newbyteorder("<"), count, self.at)
        self.at += values.nbytes
        return values

    def one(self, kind):
        return self.take(kind, 1)[0].item()


def decode(data):
    """Return the fields of a tile; an AssertionError says which rule it breaks."""
    reader = Reader(data)
    tile = SimpleNamespace(centre=reader.take("f8", 3))
    tile.minimum, tile.maximum = reader.take("f4", 2).astype(float)
    tile.sphere_centre, tile.sphere_radius = reader.take("f8", 3), reader.one("f8")
    tile.occlusion = reader.take("f8", 3)
    n_vertices = reader.one("u4")
    tile.u, tile.v, tile.steps = (
        undone_differences(reader.take("u2", n_vertices)) for _ in range(3)
    )
    kind = "u4" if n_vertices > 65536 else "u2"
    padding = -reader.at % np.dtype(kind).itemsize
    assert not any(reader.take("u1", padding))
    tile.triangles = undone_high_water_marks(reader.take(kind, 3 * reader.one("u4")))
    tile.edges = [reader.take(kind, reader.one("u4")).astype(int) for _ in range(4)]
    tile.extensions = {}
    while reader.at < len(data):
        name, length = struct.unpack_from("<BI", data, reader.at)
        reader.at += 5
        assert name not in tile.extensions
        tile.extensions[name] = reader.take("u1", length)
    assert reader.at == len(data)
    tile.heights = tile.minimum + tile.steps * ((tile.maximum - tile.minimum) / LARGEST)
    return tile


def undone_differences(codes):
    values, value = [], 0
    for code in codes.tolist():
        value += (code >> 1) ^ -(code & 1)
        values.append(value)
    return np.array(values)


def undone_high_water_marks(codes):
    highest, indices = 0, []
    for code in codes.tolist():
        indices.append(highest - code)
        highest += code == 0
    return np.array(indices).reshape(-1, 3)


def normals_of(tile):
    """Return the unit normals of vertices from their octahedral bytes."""
    p, q = tile.extensions[OCT_NORMALS].reshape(-1, 2).T / 255.0 * 2.0 - 1.0
    z = 1.0 - abs(p) - abs(q)
    folded_p, folded_q = (
        (1 - abs(q)) * np.where(p < 0, -1, 1),
        (1 - abs(p)) * np.where(q < 0, -1, 1),
    )
    normals = np.stack([np.where(z < 0, folded_p, p), np.where(z < 0, folded_q, q), z], axis=1)
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def earth_centred(tile, bounds):
    """Return places of vertices; bounds are west, south, east, north in degrees or in EPSG:3857."""
    west, south, east, north = edges_in_radians(bounds)
    longitude = west + (east - west) * tile.u / LARGEST
    latitude = south + (north - south) * tile.v / LARGEST
    up = np.stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ],
        axis=1,
    )
    on_ellipsoid = RADII**2 * up / np.sqrt((RADII**2 * up**2).sum(axis=1))[:, None]
    return on_ellipsoid + tile.heights[:, None] * up


def edges_in_radians(bounds):
    if not bounds.is_mercator:
        return np.radians(bounds.edges)
    west, south, east, north = np.array(bounds.edges) / RADII[0]
    south, north = 2 * np.arctan(np.exp([south, north])) - np.pi / 2
    return west, south, east, north


def check(data, bounds):
    """Return the decoded tile after checking all that the specification asks of it."""
    tile = decode(data)
    n_vertices = len(tile.u)
    for numbers in (tile.u, tile.v, tile.steps):
        assert numbers.min() >= 0
        assert numbers.max() <= LARGEST
    assert tile.triangles.min() == 0
    assert tile.triangles.max() == n_vertices - 1  # all are used, in order of first use
    assert len({*zip(tile.u.tolist(), tile.v.tolist(), strict=True)}) == n_vertices
    check_winding(tile)
    check_edges(tile)
    check_header(tile, earth_centred(tile, bounds))
    if OCT_NORMALS in tile.extensions:
        assert tile.extensions[OCT_NORMALS].size == 2 * n_vertices
    return tile


def check_winding(tile):
    (u0, u1, u2), (v0, v1, v2) = tile.u[tile.triangles].T, tile.v[tile.triangles].T
    doubled_areas = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    assert doubled_areas.min() > 0


def check_edges(tile):
    on_edges = tile.u == 0, tile.v == 0, tile.u == LARGEST, tile.v == LARGEST
    for edge, on_edge in zip(tile.edges, on_edges, strict=True):
        assert len(edge) == len(set(edge.tolist()))
        assert sorted(edge.tolist()) == np.flatnonzero(on_edge).tolist()


def check_header(tile, positions):
    assert tile.minimum <= tile.heights.min()
    assert tile.heights.max() <= tile.maximum
    assert tile.maximum > tile.minimum
    assert np.all(positions.min(axis=0) <= tile.centre + 1e-6)
    assert np.all(tile.centre <= positions.max(axis=0) + 1e-6)
    distances = np.linalg.norm(positions - tile.sphere_centre, axis=1)
    assert distances.max() <= tile.sphere_radius + 1e-6
    # A sphere around the box of all vertices is good enough.
    assert tile.sphere_radius <= np.linalg.norm(np.ptp(positions, axis=0)) / 2 + 1e-3
    check_occlusion(tile.occlusion, positions / RADII)


def check_occlusion(point, scaled):
    """Where a vertex is seen from, the point is seen too, with vertices below sea level raised."""
    if np.isnan(point).any():
        assert np.isnan(point).all()
        return
    sizes = np.linalg.norm(scaled, axis=1)[:, None]
    scaled = scaled / np.minimum(sizes, 1.0)
    generator = np.random.default_rng(0)
    spread = 10.0 ** generator.uniform(-5, 0.5, (N_CAMERAS, 1))
    directions = point / np.linalg.norm(point) + spread * generator.normal(size=(N_CAMERAS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    cameras = directions * (1.0 + 10.0 ** generator.uniform(-6, 0.7, (N_CAMERAS, 1)))
    for camera in cameras:
        if (visibility(scaled, camera) > 1e-9).any():
            assert visibility(point[None], camera)[0] > -1e-9


def visibility(points, camera):
    """Return more than 0 for points that the unit sphere does not hide from a camera outside it.

    A point is hidden behind the plane of the horizon and inside the cone that touches it there.
    """
    towards = points - camera
    along = -(towards @ camera)
    horizon_squared = camera @ camera - 1.0
    before_plane = horizon_squared - along
    outside_cone = horizon_squared * (towards**2).sum(axis=1) - along * abs(along)
    return np.maximum(before_plane, outside_cone)
