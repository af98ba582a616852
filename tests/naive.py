"""Slow and literal twins of what `rtin` computes: plain Python, never optimised.

Nothing here is shared with the package. The lattice comes from bisecting explicit corners at the
midpoint of the hypotenuse; heights are exact fractions. Every place is a pair (row, col).
"""

from fractions import Fraction
from functools import cache
from itertools import combinations, pairwise, product

import numpy as np

# --- the lattice --------------------------------------------------------------------------------
# A triangle is (apex, a, b): its hypotenuse runs from a to b.


def lattice_size(shape):
    """The smallest power of two that is not below rows - 1 and cols - 1."""
    size = 1
    while size + 1 < max(shape):
        size *= 2
    return size


def corners_of_lattice(size):
    return {(0, 0), (0, size), (size, 0), (size, size)}


def roots(size):
    """The two triangles of the coarsest mesh, on either side of the diagonal from (0, 0)."""
    return [((0, size), (0, 0), (size, size)), ((size, 0), (0, 0), (size, size))]


def midpoint(triangle):
    _, a, b = triangle
    return (a[0] + b[0]) // 2, (a[1] + b[1]) // 2


def is_unit(triangle):
    """Whether the hypotenuse has no sample at its midpoint."""
    _, a, b = triangle
    return (a[0] + b[0]) % 2 == 1 or (a[1] + b[1]) % 2 == 1


def halves(triangle):
    apex, a, b = triangle
    middle = midpoint(triangle)
    return [(middle, apex, a), (middle, apex, b)]


@cache
def all_triangles(size):
    """Every triangle of the hierarchy, the larger before the smaller."""
    found = list(roots(size))
    for triangle in found:
        if not is_unit(triangle):
            found += halves(triangle)
    return found


@cache
def bisections(size):
    """The triangles whose hypotenuse each vertex bisects: two, or one on the border."""
    found = {}
    for triangle in all_triangles(size):
        if not is_unit(triangle):
            found.setdefault(midpoint(triangle), []).append(triangle)
    return found


def parents(vertex, size):
    return [apex for apex, _, _ in bisections(size).get(vertex, [])]


def ends(vertex, size):
    """The ends a and b of the edge that the vertex bisects; None at the lattice's corners."""
    if vertex not in bisections(size):
        return None
    _, a, b = bisections(size)[vertex][0]
    return a, b


def level_spacing(vertex, size):
    """How far apart the samples are on the coarsest level that has this vertex."""
    spacing = size
    while vertex[0] % spacing or vertex[1] % spacing:
        spacing //= 2
    return spacing


def cross(origin, p, q):
    """Twice the signed area of a triangle."""
    return (p[0] - origin[0]) * (q[1] - origin[1]) - (p[1] - origin[1]) * (q[0] - origin[0])


@cache
def weights(triangle):
    """Barycentric coordinates, at each sample inside or on the triangle: {place: (apex, a, b)}."""
    apex, a, b = triangle
    area = cross(apex, a, b)
    found = {}
    for row in range(min(p[0] for p in triangle), max(p[0] for p in triangle) + 1):
        for col in range(min(p[1] for p in triangle), max(p[1] for p in triangle) + 1):
            place = (row, col)
            parts = cross(place, a, b), cross(apex, place, b), cross(apex, a, place)
            parts = tuple(Fraction(part, area) for part in parts)
            if min(parts) >= 0:
                found[place] = parts
    return found


# --- heights ------------------------------------------------------------------------------------


def exact_heights(heights):
    """{place: exact height} of the samples that have one."""
    return {
        (row, col): Fraction(float(heights[row, col]))
        for row, col in np.ndindex(heights.shape)
        if not np.isnan(heights[row, col])
    }


def worst_error(triangle, exact):
    """Largest distance of a sample from a triangle's plane; 0 if it has none, inf if some lack."""
    samples = weights(triangle)
    n_valid = sum(place in exact for place in samples)
    if n_valid == 0:
        return 0
    if n_valid < len(samples):
        return float("inf")
    return max(abs(error) for error in errors_in(triangle, exact).values())


def errors_in(triangle, exact):
    planes = [exact[corner] for corner in triangle]
    return {
        place: sum(part * z for part, z in zip(parts, planes, strict=True)) - exact[place]
        for place, parts in weights(triangle).items()
    }


def gain(vertex, exact, size):
    """How far the sum of squared errors falls when triangles are bisected at a vertex.

    None where a sample of theirs lacks a height.
    """
    triangles = bisections(size).get(vertex, [])
    if any(place not in exact for t in triangles for place in weights(t)):
        return None
    before, after = {}, {}
    for triangle in triangles:
        before |= errors_in(triangle, exact)
        for half in halves(triangle):
            after |= errors_in(half, exact)
    return sum(error**2 for error in before.values()) - sum(error**2 for error in after.values())


def is_good(triangle, exact, tolerance):
    """Whether a triangle needs no split: all its samples void, or all within the tolerance."""
    worst = worst_error(triangle, exact)
    if worst in (0, float("inf")):
        return worst == 0 or is_unit(triangle)
    if np.ndim(tolerance) == 0:
        return worst <= tolerance
    return all(abs(e) <= tolerance[place] for place, e in errors_in(triangle, exact).items())


# --- the paper's algorithm ----------------------------------------------------------------------


def retriangulate(kept, size):
    """Step 4: bisect, at the longest edge, each triangle with a kept vertex besides its corners.

    Again and again until there is none: each bisection adds a vertex. Returns the vertices and
    the triangles.
    """
    kept = set(kept) | corners_of_lattice(size)
    triangles = roots(size)
    while True:
        hanging = {t for t in triangles if any(p in kept for p in weights(t) if p not in t)}
        if not hanging:
            return kept, triangles
        kept |= {midpoint(t) for t in hanging}
        triangles = [part for t in triangles for part in (halves(t) if t in hanging else [t])]


def rtin_coarsening(unmarked, size):
    """Algorithm RTIN-Coarsening of the paper, from its matrix C: the vertices not to be removed."""
    kept = set(unmarked) | corners_of_lattice(size)
    spacing = 1
    while spacing < size:  # steps 1 and 2: the levels from k down, and the proper vertices of each
        for vertex in [v for v in kept if level_spacing(v, size) == spacing]:
            kept |= set(ends(vertex, size))  # step 3
        spacing *= 2
    return retriangulate(kept, size)  # step 4


def vertex_errors(heights):
    """E(v) of Eq. (1), in float64."""
    size = lattice_size(heights.shape)
    errors = np.full(heights.shape, np.nan)
    exact = exact_heights(heights)
    for place in exact:
        a, b = ends(place, size) or (None, None)
        if a in exact and b in exact:
            errors[place] = float(abs((exact[a] + exact[b]) / 2 - exact[place]))
        else:
            errors[place] = np.inf
    return errors


# --- the meshes ---------------------------------------------------------------------------------


def least(heights, tolerance, keep=()):
    """Vertices and triangles of the least conforming mesh whose triangles are all good.

    While a triangle is not good, split it with what conformity demands. Both are those of the
    whole lattice: ``visible`` leaves out what has a void corner.
    """
    size = lattice_size(heights.shape)
    exact = exact_heights(heights)
    kept, triangles = retriangulate(keep, size)
    while bad := [t for t in triangles if not is_good(t, exact, tolerance)]:
        kept, triangles = retriangulate(kept | {midpoint(t) for t in bad}, size)
    return kept, triangles


def thresholded(heights, threshold, keep=()):
    """The paper's mesh for a threshold: E(v) < threshold is marked for removal."""
    errors = vertex_errors(heights)
    unmarked = {place for place in np.ndindex(heights.shape) if errors[place] >= threshold}
    return with_outline(heights, unmarked, keep)


def with_outline(heights, unmarked, keep=()):
    """The paper's mesh for some unmarked vertices, with what the voids' outline needs."""
    exact = exact_heights(heights)
    outline, _ = least(heights, float("inf"), keep)
    unmarked = {place for place in unmarked if place in exact}
    return rtin_coarsening(outline | unmarked, lattice_size(heights.shape))


def visible(heights, triangles):
    """The triangles whose three corners have a height, each a frozenset of corners."""
    exact = exact_heights(heights)
    return {frozenset(t) for t in triangles if all(corner in exact for corner in t)}


def corners_of(triangles):
    return {corner for triangle in triangles for corner in triangle}


def finest(heights):
    """The finest triangles whose three samples have a height: what every mesh must cover."""
    size = lattice_size(heights.shape)
    return visible(heights, [t for t in all_triangles(size) if is_unit(t)])


def family(heights, keep=()):
    """(tolerance, triangles) of every least mesh, the coarsest first: all tolerances are tried."""
    exact = exact_heights(heights)
    errors = {worst_error(t, exact) for t in all_triangles(lattice_size(heights.shape))}
    meshes = []
    for tolerance in sorted({*errors, 0, float("inf")}, reverse=True):
        triangles = visible(heights, least(heights, tolerance, keep)[1])
        if not meshes or triangles != meshes[-1][1]:
            meshes.append((tolerance, triangles))
    return meshes


# --- either diagonal ----------------------------------------------------------------------------


def turned(vertex, size):
    """The two triangles on the other diagonal of the square around a vertex; none on the border."""
    if len(bisections(size)[vertex]) == 1:
        return []
    (p, a, b), (q, _, _) = bisections(size)[vertex]
    return [(a, p, q), (b, p, q)]


def fits_turned(vertex, size, exact, tolerance):
    """Whether a square has no void, and all samples within the tolerance on its other diagonal."""
    other = turned(vertex, size)
    return bool(other) and all(is_good(t, exact, tolerance) for t in other)


def least_on_either_diagonal(heights, tolerance, keep=()):
    """Vertices and triangles of the least mesh whose squares may take their other diagonals.

    While a triangle is not good, keep what makes its square whole, or split it where the other
    diagonal is no good either.
    """
    size = lattice_size(heights.shape)
    exact = exact_heights(heights)
    wanted = kept = set(keep)
    while True:
        kept, triangles = retriangulate(kept | wanted, size)
        bad = {midpoint(t) for t in triangles if not is_good(t, exact, tolerance)}
        swapped = {v for v in bad if fits_turned(v, size, exact, tolerance)}
        wanted = (bad - swapped).union(*(parents(v, size) for v in swapped))
        if wanted <= kept:
            return kept, on_closer_diagonals(triangles, exact, tolerance, size)


def on_closer_diagonals(triangles, exact, tolerance, size):
    """The triangles, those of each square on the better one of its diagonals that are good."""
    squares = {}
    for triangle in triangles:
        squares.setdefault(triangle if is_unit(triangle) else midpoint(triangle), []).append(
            triangle
        )
    result = []
    for vertex, own in squares.items():
        choices = [own] if all(is_good(t, exact, tolerance) for t in own) else []
        if len(own) == 2 and fits_turned(vertex, size, exact, tolerance):
            choices.append(turned(vertex, size))
        result += min(choices, key=lambda pair: squared_error(pair, exact))
    return result


def squared_error(triangles, exact):
    """Sum of the squared errors at the samples of some triangles; 0 where one is void."""
    if any(place not in exact for triangle in triangles for place in weights(triangle)):
        return 0
    errors = {place: e for t in triangles for place, e in errors_in(t, exact).items()}
    return sum(e**2 for e in errors.values())


def family_on_either_diagonal(heights, keep=()):
    """(tolerance, triangles) of every such mesh, the coarsest first: all tolerances are tried."""
    exact, size = exact_heights(heights), lattice_size(heights.shape)
    others = [t for vertex in bisections(size) for t in turned(vertex, size)]
    errors = {worst_error(t, exact) for t in all_triangles(size) + others}
    return [
        (tolerance, visible(heights, least_on_either_diagonal(heights, tolerance, keep)[1]))
        for tolerance in sorted({*errors, 0, float("inf")}, reverse=True)
    ]


# --- level of detail ----------------------------------------------------------------------------
# A mesh for a view keeps the vertices whose error, as large as it can look, is above the tolerance.


@cache
def children(size):
    """{vertex: those that it is an apex for}, the finest first."""
    found = {vertex: [] for vertex in reversed(bisections(size))}
    for vertex in found:
        for parent in parents(vertex, size):
            found.get(parent, []).append(vertex)  # the lattice's corners are in every mesh
    return found


@cache
def finest_parts(triangle):
    if is_unit(triangle):
        return [triangle]
    return [part for half in halves(triangle) for part in finest_parts(half)]


def has_three(triangle, exact):
    return all(corner in exact for corner in triangle)


def is_mixed(triangle, exact):
    """Whether a triangle must be split to tell heights from voids."""
    whole = [has_three(part, exact) for part in finest_parts(triangle)]
    return not all(whole) and (any(whole) or has_three(triangle, exact))


def own_error(vertex, exact, size):
    """Largest error of the triangles, with three heights, whose hypotenuse a vertex bisects."""
    errors = [
        abs(sum(part * exact[c] for part, c in zip(parts, t, strict=True)) - exact[place])
        for t in bisections(size)[vertex] if has_three(t, exact)
        for place, parts in weights(t).items() if place in exact
    ]  # fmt: skip
    return max(errors, default=0)


def saturated(heights, growth):
    """{vertex: (error, whether mixed, reach, heights)}, of it and all its descendants.

    An error is at least ``growth`` times those of the children. Where no triangle is mixed, one of
    the finest level stands for itself alone, others for the samples of their triangles as well:
    ``reach`` is how far these are, in rows or columns, ``heights`` their lowest and highest one.
    """
    size, exact = lattice_size(heights.shape), exact_heights(heights)
    found = {}
    for vertex, below in children(size).items():
        triangles = bisections(size)[vertex]
        parts = [found[child] for child in below]
        mixed = any(is_mixed(t, exact) for t in triangles) or any(part[1] for part in parts)
        samples = {vertex}.union(*(weights(t) for t in triangles if below or mixed))
        z = [exact[place] for place in samples if place in exact]
        z += [height for _, _, _, range_ in parts for height in range_]
        found[vertex] = (
            max([own_error(vertex, exact, size), *(growth * part[0] for part in parts)]),
            mixed,
            max((far(vertex, c) + found[c][2] for c in below), default=0),
            (min(z), max(z)) if z else (),
        )
    return found


def far(one, other):
    return max(abs(one[0] - other[0]), abs(one[1] - other[1]))


def weights_by_height(heights, growth):
    """{vertex: the error it stands for}; inf where voids need it."""
    return {
        vertex: float("inf") if mixed else float(error)
        for vertex, (error, mixed, _, _) in saturated(heights, growth).items()
    }


def weights_by_pixels(grid, growth, eye, scale, planes, slack=0.0):
    """{vertex: the most pixels that its error, or what is mixed, can take}; -1 if out of sight.

    A length of 1 at a distance of 1 takes ``scale`` pixels. ``slack`` widens all boxes a little.
    """
    size = lattice_size(grid.shape)
    found = dict.fromkeys(corners_of_lattice(size), float("inf"))
    hierarchy = saturated(grid.heights, growth)
    for vertex in reversed(hierarchy):
        error, mixed, reach, range_ = hierarchy[vertex]
        length = max(float(error), hypotenuse_on_the_ground(vertex, size, grid) if mixed else 0.0)
        weight = 0.0
        if length > 0.0:
            low, high = (float(z) for z in range_)
            margin = slack * max(abs(low), abs(high), 1.0)
            box = (vertex, reach + mixed + slack, low - margin, high + margin)
            near = distance_to_box(grid, eye, *box)
            weight = length * scale / near if near > 0.0 else float("inf")
            if is_out_of_sight(grid, planes, *box):
                weight = -1.0
        found[vertex] = min([weight, *(found[parent] for parent in parents(vertex, size))])
    return found


def hypotenuse_on_the_ground(vertex, size, grid):
    """As long as it would be if the longer side of a cell were both sides."""
    a, b, _, d, e, _ = tuple(grid.transform)[:6]
    one, other = ends(vertex, size)
    steps = np.hypot(one[0] - other[0], one[1] - other[1])
    return steps * max(np.hypot(a, d), np.hypot(b, e))


def distance_to_box(grid, eye, vertex, reach, low, high):
    """Distance to a box of samples whose rows and columns are at right angles."""
    a, b, _, d, e, _ = tuple(grid.transform)[:6]
    col, row = ~grid.transform @ (eye[0], eye[1])
    down = max(abs(row - vertex[0]) - reach, 0.0) * np.hypot(b, e)
    across = max(abs(col - vertex[1]) - reach, 0.0) * np.hypot(a, d)
    up = max(low - eye[2], eye[2] - high, 0.0)
    return float(np.sqrt(down**2 + across**2 + up**2))


def is_out_of_sight(grid, planes, vertex, reach, low, high):
    """Whether all eight corners of a box are outside one of the planes."""
    row, col = vertex
    corners = [
        (*(grid.transform @ (col + right, row + down)), z, 1.0)
        for right in (-reach, reach) for down in (-reach, reach) for z in (low, high)
    ]  # fmt: skip
    return bool((np.array(corners) @ np.transpose(planes) < 0.0).all(axis=0).any())


def kept_above(weights_of, tolerance, size):
    """The vertices that weigh more than a tolerance, and the lattice's corners."""
    heavy = {vertex for vertex, weight in weights_of.items() if weight > tolerance}
    return heavy | corners_of_lattice(size)


# --- a mesh against its raster ------------------------------------------------------------------


def places(mesh, grid):
    """(row, col) of each vertex of a mesh that was coarsened from the grid."""
    back = ~grid.transform
    exact = [back @ (x, y) for x, y in mesh.vertices[:, :2]]
    found = [(round(row), round(col)) for col, row in exact]
    assert np.allclose([(col, row) for row, col in found], exact, atol=1e-6)
    return found


def triangles_of(mesh, grid):
    """The triangles of such a mesh, each a frozenset of places."""
    at = places(mesh, grid)
    return {frozenset(at[corner] for corner in triangle) for triangle in mesh.triangles}


def surface_minus_samples(mesh, grid):
    """Surface - sample by barycentric coordinates in the world; NaN where there is neither."""
    a, b, c, d, e, f = tuple(grid.transform)[:6]
    rows, cols = np.indices(grid.shape)
    x, y = (a * cols + b * rows), (d * cols + e * rows)
    field = np.full(grid.shape, np.nan)
    for triangle in mesh.triangles:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = mesh.vertices[triangle] - (c, f, 0.0)
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        of_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        of_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        of_a = 1.0 - of_b - of_c
        inside = (of_a >= -1e-7) & (of_b >= -1e-7) & (of_c >= -1e-7)
        surface = of_a * az + of_b * bz + of_c * cz
        field[inside] = surface[inside] - grid.heights[inside]
    return field


# --- fitted heights -----------------------------------------------------------------------------


def weights_at_samples(mesh, grid):
    """Places of the samples that a mesh covers, and the matrix that makes its heights there of z.

    Each has a row with the barycentric weights in one triangle around it, on the lattice.
    """
    vertices = grid.places(mesh.vertices[:, :2])
    rows, cols = np.indices(grid.shape)
    found = {}
    for triangle in mesh.triangles:
        (a_row, a_col), (b_row, b_col), (c_row, c_col) = vertices[triangle]
        area = (a_row - c_row) * (b_col - c_col) - (b_row - c_row) * (a_col - c_col)
        if area == 0.0:
            continue
        of_a = ((rows - c_row) * (b_col - c_col) - (b_row - c_row) * (cols - c_col)) / area
        of_b = ((a_row - c_row) * (cols - c_col) - (rows - c_row) * (a_col - c_col)) / area
        weights = np.stack([of_a, of_b, 1.0 - of_a - of_b])
        for row, col in np.argwhere((weights > -1e-9).all(axis=0) & ~np.isnan(grid.heights)):
            found[row, col] = np.zeros(len(vertices))
            found[row, col][triangle] = weights[:, row, col]
    return list(found), np.array(list(found.values()))


def least_squares_heights(mesh, grid):
    """Heights of least squares; vertices that samples hardly see stay at theirs."""
    places, weights = weights_at_samples(mesh, grid)
    z = mesh.vertices[:, 2].copy()
    heights = np.array([grid.heights[place] for place in places], np.float64)
    free = (weights**2).sum(axis=0) >= 0.25
    z[free] += np.linalg.lstsq(weights[:, free], heights - weights @ z, rcond=None)[0]
    return z


def least_squares_within(mesh, grid, allowed):
    """The same under the condition that no sample is farther off than allowed, an array.

    Lawson and Hanson's least distance programming, "Solving least squares problems", chapter 23:
    the nearest point to the unconstrained solution, in the norm that the sum of squares gives.
    """
    from scipy.optimize import nnls

    places, weights = weights_at_samples(mesh, grid)
    z = least_squares_heights(mesh, grid)
    errors = weights @ z - [float(grid.heights[place]) for place in places]
    limits = np.array([allowed[place] for place in places])
    triangular = np.linalg.cholesky(weights.T @ weights)
    slopes = np.linalg.solve(triangular, weights.T)
    at_least = np.concatenate([errors - limits, -errors - limits])
    matrix = np.vstack([np.hstack([-slopes, slopes]), at_least])
    wanted = np.eye(len(matrix))[-1]
    left = matrix @ nnls(matrix, wanted, maxiter=20_000)[0] - wanted
    return z + np.linalg.solve(triangular.T, -left[:-1] / left[-1])


# --- all meshes of a small lattice --------------------------------------------------------------


def closed_sets(size, base=None, free=None):
    """Every set of vertices that holds the lattice's corners and the parents of its members.

    Or every such set that holds a closed one, with no others but those that are free.
    """
    order = sorted(free or bisections(size), key=lambda vertex: len(ancestors(vertex, size)))
    sets = [frozenset(base or corners_of_lattice(size))]
    for vertex in order:
        sets += [s | {vertex} for s in sets if all(p in s for p in parents(vertex, size))]
    return sets


@cache
def ancestors(vertex, size):
    """The parents of a vertex, theirs, and so on: fewer for a parent than for its child."""
    direct = parents(vertex, size)
    return set(direct).union(*(ancestors(parent, size) for parent in direct))


@cache
def conforming_meshes(size):
    """Every conforming mesh made of bisections, as a frozenset of triangles: all are tried."""
    north, south = ([t for t in trees(root) if is_conforming(t)] for root in roots(size))
    return [one | other for one in north for other in south if is_conforming(one | other)]


def trees(triangle):
    """Every set of leaves that bisections of one triangle can make."""
    meshes = [frozenset([triangle])]
    if not is_unit(triangle):
        left, right = (trees(half) for half in halves(triangle))
        meshes += [one | other for one in left for other in right]
    return meshes


def is_conforming(triangles):
    """Whether no corner of one triangle lies inside an edge of another."""
    vertices = corners_of(triangles)
    return not any(
        cross(p, q, v) == 0 and min(p, q) < v < max(p, q)
        for triangle in triangles
        for p, q in pairwise((*triangle, triangle[0]))
        for v in vertices
    )


# --- refinement ---------------------------------------------------------------------------------
# Here a triangle is (a, b, c), counter-clockwise: three places (x, y, z) of floats or fractions,
# of which a and b end the edge to bisect first.


def refined(triangles, targets, scheme):
    """Algorithm RTIN-Refinement of the paper: the midpoints it adds, and the triangles it leaves.

    ``targets`` are numbers of triangles.
    """
    marked = marked_edges(triangles, [triangles[target] for target in targets], scheme)
    midpoints = [
        middle(*edge) for t in triangles for edge in edges_of(t, directed=True)
        if frozenset(edge) in marked
    ]  # fmt: skip
    leaves = [part for t in triangles for part in pieces(t, marked, scheme)]  # step 5
    return list(dict.fromkeys(midpoints)), leaves


def marked_edges(triangles, targets, scheme):
    """Steps 1 to 4: the edges to bisect."""
    beside = {}  # edge: the triangles that have it
    for triangle in triangles:
        for edge in edges_of(triangle):
            beside.setdefault(edge, []).append(triangle)

    def conforms(triangle):
        first, *others = edges_of(triangle)
        return first in marked or not marked.intersection(others)

    def neighbour(triangle):  # the LEneighbor
        others = [t for t in beside[edges_of(triangle)[0]] if t != triangle]
        return others[0] if others else None

    marked = set()
    for target in targets:  # step 1
        marked.update(edges_of(target)[: 1 if scheme == "bisection" else 3])
    for triangle in [t for t in triangles if not conforms(t)]:  # steps 2 and 3
        while triangle is not None and not conforms(triangle):  # step 4
            marked.add(edges_of(triangle)[0])
            triangle = neighbour(triangle)
    return marked


def walks(triangles, target):
    """The numbers of the triangles on the three walks of section 2.1.2 from a target.

    Each goes over a side of the target, and then over one longest edge after another.
    """
    beside = {}
    for number, triangle in enumerate(triangles):
        for edge in edges_of(triangle):
            beside.setdefault(edge, []).append(number)

    def walk(edge):
        met, here = [], target
        while True:
            others = [number for number in beside[edge] if number != here]
            if not others or others[0] == target or others[0] in met:
                return met
            here = others[0]
            met.append(here)
            if edges_of(triangles[here])[0] == edge:
                return met
            edge = edges_of(triangles[here])[0]

    return [walk(edge) for edge in edges_of(triangles[target])]


def edges_of(triangle, directed=False):
    pairs = pairwise((*triangle, triangle[0]))
    return list(pairs) if directed else [frozenset(pair) for pair in pairs]


def middle(a, b):
    return tuple((p + q) / 2 for p, q in zip(a, b, strict=True))


def pieces(triangle, marked, scheme):
    """What becomes of a triangle: itself without a mark, or its parts by repeated bisection."""
    if not marked.intersection(edges_of(triangle)):
        return [triangle]
    a, b, c = triangle
    m, p, q = middle(a, b), middle(b, c), middle(c, a)
    if scheme == "4T-SS" and marked.issuperset(edges_of(triangle)):
        parts = [(q, p, c), (a, m, q), (m, b, p), (p, q, m)]
    else:
        parts = []
        for start, end, apex in [(c, a, m), (b, c, m)]:
            if frozenset((start, end)) in marked:
                new = middle(start, end)
                parts += [(apex, start, new), (end, apex, new)]
            else:
                parts.append((start, end, apex))
    return [with_longest_first(part) for part in parts]


def with_longest_first(triangle):
    """The corners (start, end, newest), rotated by the rule for ties in the docstring of refine."""
    a, b, newest = triangle
    if nearly_equal(length_squared(b, newest), length_squared(newest, a)):
        return triangle
    rotations = [(a, b, newest), (b, newest, a), (newest, a, b)]
    longest = max(length_squared(t[0], t[1]) for t in rotations)
    tied = [t for t in rotations if nearly_equal(length_squared(t[0], t[1]), longest)]
    return max(tied, key=lambda t: abs(along(t[0], t[1])))


def nearly_equal(p, q):
    return abs(p - q) <= max(p, q) / 1_000_000


def length_squared(a, b):
    return (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2


def along(a, b):
    """How far b is from a in the direction one radian north of east."""
    return float(b[0] - a[0]) * np.cos(1.0) + float(b[1] - a[1]) * np.sin(1.0)


# --- refinement and coarsening in turn ----------------------------------------------------------


class Piece:
    """A triangle of some time: one of the mesh, or bisected into two halves."""

    def __init__(self, corners):
        self.corners = corners
        self.halves = []
        self.undone = None  # the call of refine of which it was split, and has just been merged
        # Only where 4T-SS has split it: besides the outer quarters, the two across. The inner
        # quarters, which they lie across, come back when one of the sides' midpoints goes.
        self.across = []
        self.whole = None  # of a half of that: what it is a half of
        self.inner = self.outer = None  # and its quarters

    def leaves(self):
        """The triangles of the mesh in it."""
        parts = self.halves
        if self.across:
            parts = [half.outer for half in self.halves] + self.across
        return [leaf for part in parts for leaf in part.leaves()] if parts else [self]


class History:
    """A mesh as a set of triangles, and how each of them came to be."""

    def __init__(self, triangles):
        self.roots = [Piece(triangle) for triangle in triangles]
        self.bisected = {}  # midpoint: the pieces that it bisects, on one side of it or on both
        self.calls = {}  # midpoint: which call of refine has made it
        self.n_calls = 0

    def leaves(self):
        return [leaf for root in self.roots for leaf in root.leaves()]

    def triangles(self):
        return {leaf.corners for leaf in self.leaves()}

    # - refine -

    def refine(self, targets, scheme):
        """``targets`` are triangles."""
        self.n_calls += 1
        leaves = self.leaves()
        marked = marked_edges([leaf.corners for leaf in leaves], targets, scheme)
        for leaf in leaves:
            if marked.intersection(edges_of(leaf.corners)):
                self.split(leaf, marked, scheme)

    def split(self, leaf, marked, scheme):
        a, b, c = leaf.corners
        m, p, q = middle(a, b), middle(b, c), middle(c, a)
        one, other = self.bisect(leaf, (a, b, c))
        if frozenset((c, a)) in marked:
            one.inner, one.outer = self.bisect(one, (c, a, m))
        if frozenset((b, c)) in marked:
            other.outer, other.inner = self.bisect(other, (b, c, m))
        if scheme == "4T-SS" and one.inner and other.inner:
            leaf.across = [Piece((q, p, c)), Piece((p, q, m))]
            one.whole = other.whole = leaf

    def bisect(self, piece, corners):
        a, b, c = corners
        m = middle(a, b)
        piece.halves = [Piece(with_longest_first(half)) for half in [(c, a, m), (b, c, m)]]
        self.bisected.setdefault(m, []).append(piece)
        self.calls[m] = self.n_calls
        return piece.halves

    # - coarsen -

    def coarsen(self, targets):
        """``targets`` are triangles. Midpoints go as long as one can, in any order."""
        leaves = self.leaves()
        around = {}
        for leaf in leaves:
            leaf.undone = None
            for corner in leaf.corners:
                around.setdefault(corner, set()).add(leaf)
        targets = {leaf for leaf in leaves if leaf.corners in set(targets)}

        def can_go(vertex):
            return around[vertex] == self.made_by(vertex) and all(
                leaf in targets or leaf.undone == self.calls[vertex] for leaf in around[vertex]
            )

        def remove(vertex):
            old, new = around.pop(vertex), self.remove(vertex)
            for leaf in old:
                for corner in set(leaf.corners) - {vertex}:
                    around[corner].discard(leaf)
            for leaf in new:
                leaf.undone = self.calls[vertex]
                for corner in leaf.corners:
                    around[corner].add(leaf)

        while going := next(filter(can_go, self.bisected), None):
            remove(going)

    def made_by(self, vertex):
        """The triangles that came of bisecting its edge (pieces that are no longer whole too)."""
        made = set()
        for piece in self.bisected[vertex]:
            is_crossed = piece.whole is not None and piece.whole.across
            made.update([piece.outer, *piece.whole.across] if is_crossed else piece.halves)
        return made

    def remove(self, vertex):
        """Undo its bisection: the triangles that are new."""
        new = []
        for piece in self.bisected.pop(vertex):
            if piece.whole is not None and piece.whole.across:
                new += [half.inner for half in piece.whole.halves if half is not piece]
                piece.whole.across = []
            piece.halves, piece.inner, piece.outer, piece.whole = [], None, None, None
            new.append(piece)
        return new


# --- distances ----------------------------------------------------------------------------------
# Points are triples of exact fractions, triangles are three of them, and so are squares exact.


def exact_points(points):
    return [tuple(Fraction(float(value)) for value in point) for point in points]


def triangles_in_space(surface):
    """The exact triangles of a mesh, or the finest ones of a grid."""
    if hasattr(surface, "triangles"):
        return [tuple(exact_points(surface.vertices[t])) for t in surface.triangles]
    a, b, c, d, e, f = (Fraction(value) for value in tuple(surface.transform)[:6])
    exact = exact_heights(surface.heights)
    at = {(r, q): (a * q + b * r + c, d * q + e * r + f, z) for (r, q), z in exact.items()}
    return [tuple(at[corner] for corner in triangle) for triangle in finest(surface.heights)]


def dot(p, q):
    return sum(x * y for x, y in zip(p, q, strict=True))


def minus(p, q, times=1):
    return tuple(x - times * y for x, y in zip(p, q, strict=True))


def square_to_segment(point, a, b):
    side, off = minus(b, a), minus(point, a)
    length = dot(side, side)
    off = minus(off, side, min(max(dot(off, side) / length, 0), 1) if length else 0)
    return dot(off, off)


def square_to_triangle(point, triangle):
    """Squared distance: to the plane if the foot is inside, by least squares, else to the sides."""
    a, b, c = triangle
    u, v, w = minus(b, a), minus(c, a), minus(point, a)
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    determinant = uu * vv - uv * uv
    if determinant:
        s, t = (vv * uw - uv * vw) / determinant, (uu * vw - uv * uw) / determinant
        if s >= 0 and t >= 0 and s + t <= 1:
            off = minus(minus(w, u, s), v, t)
            return dot(off, off)
    return min(square_to_segment(point, p, q) for p, q in combinations(triangle, 2))


def distances(points, surface):
    """From each point to the nearest of all the surface's triangles, rounded once."""
    triangles = triangles_in_space(surface)
    return np.array(
        [
            float(min(square_to_triangle(point, t) for t in triangles)) ** 0.5
            for point in exact_points(points)
        ]
    )


# --- the overlay --------------------------------------------------------------------------------
# A polygon is a list of exact points (x, y, height of one plane, height of the other, …).


def clipped(polygon, side):
    """The part of a convex polygon where a linear function of its points is zero or more."""
    kept = []
    for p, q in pairwise([*polygon, polygon[0]] if polygon else []):
        at_p, at_q = side(p), side(q)
        if at_p >= 0:
            kept.append(p)
        if at_p * at_q < 0:
            kept.append(minus(p, minus(p, q), at_p / (at_p - at_q)))
    return kept


def on_plane(triangle, point):
    a, b, c = triangle
    area = cross(a, b, c)
    parts = cross(point, b, c), cross(a, point, c), cross(a, b, point)
    return sum(part * corner[2] for part, corner in zip(parts, triangle, strict=True)) / area


def shared_polygon(one, other):
    """What two triangles share, seen from above, each corner with its difference of heights."""
    polygon = [p[:2] for p in one]
    a, b, c = other if cross(*other) > 0 else other[::-1]
    for tail, head in ((a, b), (b, c), (c, a)):
        polygon = clipped(polygon, lambda p, tail=tail, head=head: cross(tail, head, p))
    return [(*p, on_plane(other, p) - on_plane(one, p)) for p in polygon]


def volume_and_area(polygon):
    fan = [(polygon[0], p, q) for p, q in pairwise(polygon[1:])]
    areas = [abs(cross(*triangle)) / 2 for triangle in fan]
    heights = [sum(p[2] for p in triangle) / 3 for triangle in fan]
    return dot(areas, heights), sum(areas)


def terrain_difference(one, other):
    """Area in common, fill, cut, largest and smallest difference of the second less the first."""
    area, fill, cut, gaps = 0, 0, 0, []
    flat = [[t for t in triangles_in_space(s) if cross(*t) != 0] for s in (one, other)]
    for pair in product(*flat):
        polygon = shared_polygon(*pair)
        own = volume_and_area(polygon)[1] if len(polygon) > 2 else 0
        if own > 0:
            area, gaps = area + own, gaps + [p[2] for p in polygon]
            above, below = (clipped(polygon, lambda p, s=s: s * p[2]) for s in (1, -1))
            fill += volume_and_area(above)[0] if above else 0
            cut -= volume_and_area(below)[0] if below else 0
    return tuple(float(v) for v in (area, fill, cut, max(gaps, default=0), min(gaps, default=0)))


# --- Metro's samples ----------------------------------------------------------------------------


def area_of(a, b, c):
    return np.linalg.norm(np.cross(b - a, c - a)) / 2.0


def carried(sizes, density, taken=int):
    """How many points elements of some sizes get: what is left of a point goes to the next one."""
    counts, owed = [], 0.0
    for size in sizes:
        owed += size * density
        counts.append(taken(int(owed)))
        owed -= counts[-1]
    return counts


def power_of_two(n):
    return max((2**k for k in range(40) if 2**k <= n), default=0)


def triangular(n):
    """The largest number of points inside a regular lattice that is not above n."""
    return max(m * (m + 1) // 2 for m in range(n + 1) if m * (m + 1) // 2 <= n)


def centres_of_halves(corners, n_points):
    if n_points == 1:
        return [sum(corners) / 3.0]
    _, a, b, c = max(
        (np.linalg.norm(p - q), i, j, 3 - i - j)
        for (i, p), (j, q) in combinations(enumerate(corners), 2)
    )
    middle = (corners[a] + corners[b]) / 2.0
    parts = [corners[a], middle, corners[c]], [middle, corners[b], corners[c]]
    return [centre for part in parts for centre in centres_of_halves(part, n_points // 2)]


def points_of_lattice(corners, n_points):
    n = 3
    while (n - 1) * (n - 2) // 2 < n_points:
        n += 1
    inside = [w for w in product(range(1, n), repeat=3) if sum(w) == n]
    return [sum(w / n * corner for w, corner in zip(ws, corners, strict=True)) for ws in inside]


TAKEN = {"subdivision": power_of_two, "similar": triangular, "montecarlo": int}
PLACED = {"subdivision": centres_of_halves, "similar": points_of_lattice}


def metro(mesh, n_samples, sampling):
    """Corners, points on edges, and counts and areas for triangles, of a mesh in one piece."""
    at = mesh.vertices
    used = sorted(set(mesh.triangles.ravel()))
    edges = sorted({tuple(sorted(e)) for t in mesh.triangles for e in combinations(t, 2)})
    lengths = [np.linalg.norm(at[b] - at[a]) for a, b in edges]
    areas = [area_of(*at[triangle]) for triangle in mesh.triangles]
    left = n_samples - len(used)
    if left <= 0:
        return at[used], np.empty((0, 3)), [0] * len(areas), areas
    # A millionth of a point to spare, as totals that are whole numbers would be rounded.
    per_length = min((left / sum(areas)) ** 0.5, (left * 9 // 10 + 1e-6) / sum(lengths))
    on_edges = [
        at[a] + i / (n + 1) * (at[b] - at[a])
        for (a, b), n in zip(edges, carried(lengths, per_length), strict=True)
        for i in range(1, n + 1)
    ]
    left -= int(sum(lengths) * per_length)
    counts = carried(areas, (left + 1e-6) / sum(areas), TAKEN[sampling])
    return at[used], np.array(on_edges).reshape(-1, 3), counts, areas
