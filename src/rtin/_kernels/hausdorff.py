r"""Bounds of the largest distance from triangles to a surface, by branch and bound.

No point of a surface is nearer than the surface itself, and the distance to one convex triangle is
convex. So where a part of a triangle is divided into convex polygons in any way, and each polygon
has any triangle of the other surface for itself, no point of the part is farther from that surface
than the farthest corner of a polygon is from its triangle. Three divisions are tried, the cheap
ones first: none; in two, where two triangles are equally far; and the overlay, at the edges of the
triangles below and above the part::

    one polygon      two           overlay
       /\              /\             /\
      /  \            /| \           /_/\
     /    \          / |  \         / /\_\
    +------+        +--+---+       +-+--+-+

Where all leave the largest distance open, the part is bisected at its longest edge.
"""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.distance import (
    MARGIN,
    N_COLS,
    N_ROWS,
    cell_number,
    corners_of,
    nearest_to_point,
    place_in,
    triangle_square,
)
from rtin._kernels.overlay import MOST_CORNERS, split, turn

MOST_CELLS = 64  # that a part is laid over
MOST_TRIANGLES = 64
MOST_POLYGONS = 96
OUTSIDE = 1.0 / 16.0  # of the tolerance: polygons may reach so far beyond their triangle
# A part's longest edge is at most √3 · 2**(-n/2) of the first one after n bisections (A. Adler,
# Mathematics of Computation 40, 1983), and none that is shorter than the tolerance is open: with
# a tolerance of 1e-12 of the first edge or more, 82 bisections are the most. Were there more, the
# bound would hold, but not be as near as asked for.
DEEPEST = 100

# --- one triangle -------------------------------------------------------------------------------


@jit
def square_at(x, y, z, corners):
    """Squared distance from a point to a triangle."""
    ax, ay, az, bx, by, bz, cx, cy, cz = corners
    return triangle_square(x, y, z, ax, ay, az, bx, by, bz, cx, cy, cz, np.inf)


@jit
def farthest_corner(polygon, n, corners):
    """Squared distance of the farthest corner of a polygon from a triangle, and its number."""
    largest, farthest = -1.0, 0
    for i in range(n):
        square = square_at(polygon[i, 0], polygon[i, 1], polygon[i, 2], corners)
        if square > largest:
            largest, farthest = square, i
    return largest, farthest


@jit
def whole_square(part, nearest, surface, frame):
    """No point of a part is farther from the surface than this, squared.

    Of the triangles nearest to its corners, by that whose farthest corner is nearest.
    """
    least = np.inf
    for candidate in range(3):
        number, largest = nearest[candidate], 0.0
        for corner in range(3):
            square = part[9 + corner]
            if nearest[corner] != number:
                corners = corners_of(surface, frame, number)
                x, y, z = part[3 * corner], part[3 * corner + 1], part[3 * corner + 2]
                square = square_at(x, y, z, corners)
            largest = max(largest, square)
        least = min(least, largest)
    return least


# --- two triangles ------------------------------------------------------------------------------


@jit
def distances_on_edge(part, tail, head, share, one, other):
    """Distances from a point on an edge of a part to two triangles."""
    x = part[3 * tail] + share * (part[3 * head] - part[3 * tail])
    y = part[3 * tail + 1] + share * (part[3 * head + 1] - part[3 * tail + 1])
    z = part[3 * tail + 2] + share * (part[3 * head + 2] - part[3 * tail + 2])
    return np.sqrt(square_at(x, y, z, one)), np.sqrt(square_at(x, y, z, other))


@jit
def two_square(part, one, other):
    """The same by two triangles, each for about the side of the part where it is nearer.

    Where both are planes around here, the sides meet where both are equally far.
    """
    largest = 0.0
    differences = np.empty(3)
    for corner in range(3):
        to_one, to_other = distances_on_edge(part, corner, corner, 0.0, one, other)
        differences[corner] = to_one - to_other
        largest = max(largest, min(to_one, to_other))
    for tail in range(3):
        head = (tail + 1) % 3
        at_tail, at_head = differences[tail], differences[head]
        if min(at_tail, at_head) < 0.0 and max(at_tail, at_head) > 0.0:
            share = at_tail / (at_tail - at_head)
            to_one, to_other = distances_on_edge(part, tail, head, share, one, other)
            largest = max(largest, to_one, to_other)
    return largest * largest


@jit
def least_of_twos(part, nearest, surface, frame):
    """The same by the best two of the triangles nearest to the corners."""
    least = np.inf
    for corner in range(3):
        one, other = nearest[corner], nearest[(corner + 1) % 3]
        if one != other:
            pair = corners_of(surface, frame, one), corners_of(surface, frame, other)
            least = min(least, two_square(part, pair[0], pair[1]))
    return least


# --- the overlay --------------------------------------------------------------------------------


@jit
def with_number(numbers, n, number):
    """How many numbers there are once one is among them; -1 where there is no room."""
    for i in range(n):
        if numbers[i] == number:
            return n
    if n == numbers.size:
        return -1
    numbers[n] = number
    return n + 1


@jit
def cells_under(part, shift, frame):
    """First and end row and column of the cells below a part's bounding box, shifted."""
    first_row, end_row, first_col, end_col = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(3):
        row, col = place_in(frame, part[3 * corner] + shift[0], part[3 * corner + 1] + shift[1])
        first_row, end_row = min(first_row, row), max(end_row, row)
        first_col, end_col = min(first_col, col), max(end_col, col)
    n_rows, n_cols = int(frame[N_ROWS]), int(frame[N_COLS])
    return (
        cell_number(first_row - MARGIN, n_rows),
        cell_number(end_row + MARGIN, n_rows) + 1,
        cell_number(first_col - MARGIN, n_cols),
        cell_number(end_col + MARGIN, n_cols) + 1,
    )


@jit
def fill_triangles_under(part, shift, nearest, surface, frame, numbers):
    """Write the triangles below and above a part; return how many, or -1 if these are too many.

    Those nearest to its corners come first: they take out the most.
    """
    heights, starts, members, _, _ = surface
    first_row, end_row, first_col, end_col = cells_under(part, shift, frame)
    if (end_row - first_row) * (end_col - first_col) > MOST_CELLS:
        return -1
    n, n_cols = 0, int(frame[N_COLS])
    for corner in range(3):
        n = with_number(numbers, n, nearest[corner])
    for row in range(first_row, end_row):
        for cell in range(row * n_cols + first_col, row * n_cols + end_col):
            first, end = 2 * cell, 2 * cell + 2
            if heights.size == 0:
                first, end = starts[cell], starts[cell + 1]
            for i in range(first, end):
                number = i if heights.size > 0 else np.int64(members[i])
                n = with_number(numbers, n, number)
                if n < 0:
                    return -1
    return n


@jit
def take_out(work, n, corners, shift, width, limit, point):
    """Take what lies below or above a triangle out of polygons, where that is near enough.

    Returns how many polygons are left, -1 where there was no room, and the largest squared
    distance of a corner taken out; writes the place of one that is too far.
    """
    polygons, counts, inside, other, sides = work
    largest = 0.0
    for which in range(n - 1, -1, -1):
        n_inside, end = split(
            polygons, counts, n, which, corners, shift, width, inside, other, sides
        )
        if end < 0:
            return -1, largest
        if n_inside == 0:
            continue
        square, farthest = farthest_corner(inside, n_inside, corners)
        if square > limit:
            for axis in range(3):
                point[axis] = inside[farthest, axis]
            continue
        largest, n = max(largest, square), end - 1
        counts[which] = counts[n]
        for i in range(counts[n]):
            for axis in range(3):
                polygons[which, i, axis] = polygons[n, i, axis]
    return n, largest


@jit
def overlay_square(part, nearest, surface, frame, shift, width, limit, numbers, work, point):
    """The same by the triangles below and above a part, shifted; inf where that is over a limit.

    What has none below or above it is left to the nearest ones.
    """
    n_triangles = fill_triangles_under(part, shift, nearest, surface, frame, numbers)
    polygons, counts = work[0], work[1]
    for corner in range(3):
        for axis in range(3):
            polygons[0, corner, axis] = part[3 * corner + axis]
    counts[0] = 3
    n, largest = 1, 0.0
    for i in range(n_triangles):
        corners = corners_of(surface, frame, numbers[i])
        if abs(turn(corners)) > 0.0 and not np.isnan(corners[2] + corners[5] + corners[8]):
            n, square = take_out(work, n, corners, shift, width, limit, point)
            largest = max(largest, square)
        if n <= 0:
            break
    for which in range(n):
        least = np.inf
        for corner in range(3):
            corners = corners_of(surface, frame, nearest[corner])
            least = min(least, farthest_corner(polygons[which], counts[which], corners)[0])
        largest = max(largest, least)
    return largest if n_triangles > 0 and n >= 0 and largest <= limit else np.inf


@jit
def way_to_plane(part, nearest, surface, frame):
    """X and y of the way from a part's first corner to the plane of the triangle nearest to it."""
    ax, ay, az, bx, by, bz, cx, cy, cz = corners_of(surface, frame, nearest[0])
    px, py, pz, qx, qy, qz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    normal = x * x + y * y + z * z
    if normal == 0.0:
        return 0.0, 0.0
    share = (x * (ax - part[0]) + y * (ay - part[1]) + z * (az - part[2])) / normal
    return share * x, share * y


# --- branch and bound ---------------------------------------------------------------------------


@jit
def bound_of_part(part, nearest, surface, frame, lower, tolerance, numbers, work, point):
    """No point of a part is farther from the surface than this; if need be, by the overlay.

    Writes a point that may be farther than ``lower``, or NaN.
    """
    point[0] = np.nan
    limit = (lower + tolerance) ** 2
    square = whole_square(part, nearest, surface, frame)
    if square > limit:
        square = min(square, least_of_twos(part, nearest, surface, frame))
    shift, width = (0.0, 0.0), OUTSIDE * tolerance
    for _ in range(2):
        if square > limit:
            over = overlay_square(
                part, nearest, surface, frame, shift, width, limit, numbers, work, point
            )
            square, shift = min(square, over), way_to_plane(part, nearest, surface, frame)
    return np.sqrt(square)


@jit
def bisect_part(part, nearest, other, other_nearest, point):
    """Bisect a triangle at its longest edge, in place and into another row.

    Writes the midpoint, and returns which corner of each half it is: its distance is not known yet.
    """
    longest, tail = -1.0, 0
    for side in range(3):
        end = (side + 1) % 3
        x, y = part[3 * side] - part[3 * end], part[3 * side + 1] - part[3 * end + 1]
        z = part[3 * side + 2] - part[3 * end + 2]
        square = x * x + y * y + z * z
        if square > longest:
            longest, tail = square, side
    head = (tail + 1) % 3
    for i in range(12):
        other[i] = part[i]
    for i in range(3):
        other_nearest[i] = nearest[i]
        point[i] = 0.5 * (part[3 * tail + i] + part[3 * head + i])
        part[3 * tail + i] = other[3 * head + i] = point[i]
    return tail, head


@jit
def fill_part(vertices, triangle, squares, numbers, part, nearest):
    """Write a triangle's corners, their squared distances, and what is nearest to them."""
    for corner in range(3):
        vertex = triangle[corner]
        for axis in range(3):
            part[3 * corner + axis] = vertices[vertex, axis]
        part[9 + corner], nearest[corner] = squares[vertex], numbers[vertex]


@jit
def room_for_polygons():
    """Arrays for ``take_out``: polygons, their numbers of corners, two more, and sides."""
    return (
        np.empty((MOST_POLYGONS, MOST_CORNERS, 3)),
        np.empty(MOST_POLYGONS, np.int64),
        np.empty((MOST_CORNERS, 3)),
        np.empty((MOST_CORNERS, 3)),
        np.empty(MOST_CORNERS),
    )


@jit
def bound_largest(vertices, triangles, squares, numbers, surface, frame, blocks, lower, tolerance):
    """Bounds of the largest distance from some triangles to a surface, at most so far apart.

    ``squares`` and ``numbers`` hold what is nearest to each vertex. Where no vertex nor point found
    is farther than ``lower``, that is the lower bound. Returns both bounds, and the place of the
    lower one.
    """
    parts, nearest = np.empty((DEEPEST, 12)), np.empty((DEEPEST, 3), np.int64)
    waiting, bounds = np.empty(128, np.int64), np.empty(128)
    under, work = np.empty(MOST_TRIANGLES, np.int64), room_for_polygons()
    points = np.empty((2, 3))  # one that looks far away, and the midpoint of an edge
    upper, place = lower, (np.nan, np.nan, np.nan)
    for vertex in triangles.ravel():
        if squares[vertex] > lower * lower:
            lower = np.sqrt(squares[vertex])
            place = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
    for triangle in triangles:
        fill_part(vertices, triangle, squares, numbers, parts[0], nearest[0])
        n_parts = 1
        while n_parts > 0:
            last, other = n_parts - 1, n_parts
            part = parts[last]
            farthest = bound_of_part(
                part, nearest[last], surface, frame, lower, tolerance, under, work, points[0]
            )
            if farthest <= lower + tolerance or n_parts == DEEPEST:
                upper, n_parts = max(upper, farthest), last
                continue
            tail, head = bisect_part(part, nearest[last], parts[other], nearest[other], points[1])
            square, number = np.nan, -1
            for i in range(int(np.isnan(points[0, 0])), 2):
                point = points[i, 0], points[i, 1], points[i, 2]
                square, number = nearest_to_point(point, surface, frame, blocks, waiting, bounds)
                if square > lower * lower:
                    lower, place = np.sqrt(square), point
            part[9 + tail] = parts[other, 9 + head] = square
            nearest[last, tail] = nearest[other, head] = number
            n_parts += 1
    return lower, max(lower, upper), place
