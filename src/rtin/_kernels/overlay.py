"""The overlay of two surfaces: convex polygons cut by straight lines, seen from above.

A polygon is an array of corners x, y and z, in either order around it; what is cut keeps its
slopes. I. E. Sutherland and G. W. Hodgman, "Reentrant polygon clipping", Communications of the
ACM 17(1), 1974.
"""

import numpy as np

from rtin._kernels._jit import inlined, jit
from rtin._kernels.distance import (
    N_COLS,
    N_ROWS,
    cells_in_row,
    corners_at,
    corners_of,
    place_in,
    rows_of_triangle,
)

MOST_CORNERS = 16

# What differences d add up to: areas times 1, d where it is above zero, -d where it is below, d²,
# the angle between normals in degrees, its square, the difference of slopes in degrees, and its
# square. Then the largest and smallest d with their x and y, and the largest angle and difference
# of slopes.
AREA, ABOVE, BELOW, SQUARES = 0, 1, 2, 3
ANGLE, ANGLE_SQUARES, SLOPE, SLOPE_SQUARES, N_SUMS = 4, 5, 6, 7, 8
MAX, MIN, MAX_ANGLE, MAX_SLOPE, N_EXTREMES = 0, 3, 6, 7, 8

# --- polygons -----------------------------------------------------------------------------------


@jit
def turn(corners):
    """Twice the area of a triangle from above, negative where it is clockwise."""
    ax, ay, _, bx, by, _, cx, cy, _ = corners
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@jit
def place_on_side(corners, side):
    """X and y of both ends of a triangle's side, from the first to the second counter-clockwise."""
    tail, head = 3 * side, 3 * ((side + 1) % 3)
    if turn(corners) < 0.0:
        tail, head = head, tail
    return corners[tail], corners[tail + 1], corners[head], corners[head + 1]


@jit
def fill_sides(polygon, n, line, shift, width, sides):
    """Write how far the corners, shifted, lie left of a line; 0 within a width of it.

    Returns the smallest and the largest.
    """
    ax, ay, bx, by = line
    ux, uy = bx - ax, by - ay
    length = np.sqrt(ux * ux + uy * uy)
    low, high = np.inf, -np.inf
    for i in range(n):
        x, y = polygon[i, 0] + shift[0] - ax, polygon[i, 1] + shift[1] - ay
        side = (ux * y - uy * x) / length
        sides[i] = 0.0 if abs(side) <= width else side
        low, high = min(low, sides[i]), max(high, sides[i])
    return low, high


@jit
def cut(polygon, n, sides, sign, kept):
    r"""Write the part of a polygon where sides are zero or have a sign; return its corners' number.

    Both parts get the very same new corners::

        +-----*---+
        | kept \  |
        +-------*-+
    """
    n_kept = 0
    for i in range(n):
        following = i + 1 if i + 1 < n else 0
        here, there = sign * sides[i], sign * sides[following]
        if here >= 0.0:
            for axis in range(3):
                kept[n_kept, axis] = polygon[i, axis]
            n_kept += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for axis in range(3):
                step = polygon[following, axis] - polygon[i, axis]
                kept[n_kept, axis] = polygon[i, axis] + share * step
            n_kept += 1
    return n_kept


@jit
def split(polygons, counts, n, which, corners, shift, width, inside, other, sides):
    """Split a polygon at the sides of a triangle, which has an area.

    Writes what is inside to ``inside``, and what is outside behind the ``n`` polygons that there
    are. Returns how many corners are inside, 0 if there is nothing, and how many polygons there
    are now; -1 where there is no room for them.
    """
    n_inside, end = counts[which], n
    for i in range(n_inside):
        for axis in range(3):
            inside[i, axis] = polygons[which, i, axis]
    for side in range(3):
        line = place_on_side(corners, side)
        low, high = fill_sides(inside, n_inside, line, shift, width, sides)
        if high <= 0.0:
            return 0, n
        if low < 0.0:
            if end == polygons.shape[0] or n_inside + 1 >= MOST_CORNERS:
                return 0, -1
            counts[end] = cut(inside, n_inside, sides, -1.0, polygons[end])
            n_inside = cut(inside, n_inside, sides, 1.0, other)
            end += 1
            for i in range(n_inside):
                for axis in range(3):
                    inside[i, axis] = other[i, axis]
    return n_inside, end


# --- differences of heights and slopes ----------------------------------------------------------


@jit
def gradient(corners):
    """Steps of height a unit of x and of y in the plane of a triangle with an area."""
    ax, ay, az, bx, by, bz, cx, cy, cz = corners
    area = turn(corners)
    along_x = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / area
    along_y = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / area
    return along_x, along_y


@jit
def height_on(corners, slopes, x, y):
    """Height of a triangle at a place inside it, within those of its corners whatever rounding."""
    low = min(corners[2], corners[5], corners[8])
    high = max(corners[2], corners[5], corners[8])
    height = corners[2] + slopes[0] * (x - corners[0]) + slopes[1] * (y - corners[1])
    return min(max(height, low), high)


@jit
def angles_between(one, other):
    """Degrees between the normals of two planes, and of the second one's slope less the first's."""
    (px, py), (qx, qy) = one, other
    across = np.sqrt((px * qy - py * qx) ** 2 + (px - qx) ** 2 + (py - qy) ** 2)
    angle = np.arctan2(across, 1.0 + px * qx + py * qy)
    slope = np.arctan(np.sqrt(qx * qx + qy * qy)) - np.arctan(np.sqrt(px * px + py * py))
    return np.degrees(angle), np.degrees(slope)


@jit
def mean_above(p, q, r):
    """Mean of what is above zero of a linear function over a triangle, given at its corners."""
    if q > p:
        p, q = q, p
    if r > p:
        p, r = r, p
    low = min(q, r)
    if p <= 0.0 or low >= 0.0:
        return (p + q + r) / 3.0 if low >= 0.0 else 0.0
    if max(q, r) <= 0.0:  # one corner's tip is above zero, ...
        return p / 3.0 * (p / (p - q)) * (p / (p - r))
    high, depth = max(q, r), -low  # ... or one is below
    return (p + q + r) / 3.0 + depth / 3.0 * (depth / (depth + p)) * (depth / (depth + high))


@jit
def add_heights(polygon, n, gaps, sums):
    """Add up the differences at a polygon's corners, linear between them; return its area."""
    area = 0.0
    for i in range(1, n - 1):
        px, py = polygon[i, 0] - polygon[0, 0], polygon[i, 1] - polygon[0, 1]
        qx, qy = polygon[i + 1, 0] - polygon[0, 0], polygon[i + 1, 1] - polygon[0, 1]
        part = 0.5 * abs(px * qy - py * qx)
        a, b, c = gaps[0], gaps[i], gaps[i + 1]
        area += part
        sums[ABOVE] += part * mean_above(a, b, c)
        sums[BELOW] += part * mean_above(-a, -b, -c)
        sums[SQUARES] += part * (a * a + b * b + c * c + a * b + b * c + c * a) / 6.0
    sums[AREA] += area
    return area


@jit
def note_extremes(polygon, n, gaps, extremes):
    """Note the largest and the smallest difference at a polygon's corners, and where they are."""
    for i in range(n):
        if gaps[i] > extremes[MAX]:
            extremes[MAX] = gaps[i]
            extremes[MAX + 1], extremes[MAX + 2] = polygon[i, 0], polygon[i, 1]
        if gaps[i] < extremes[MIN]:
            extremes[MIN] = gaps[i]
            extremes[MIN + 1], extremes[MIN + 2] = polygon[i, 0], polygon[i, 1]


@jit
def add_angles(area, slopes, own_slopes, sums, extremes):
    """Add up the angle between two triangles over the area that they share."""
    angle, slope = angles_between(own_slopes, slopes)
    sums[ANGLE] += area * angle
    sums[ANGLE_SQUARES] += area * angle * angle
    sums[SLOPE] += area * slope
    sums[SLOPE_SQUARES] += area * slope * slope
    extremes[MAX_ANGLE] = max(extremes[MAX_ANGLE], angle)
    extremes[MAX_SLOPE] = max(extremes[MAX_SLOPE], abs(slope))


@jit
def lie_apart(one, other):
    """Whether the upright boxes around two triangles share no area."""
    for axis in range(2):
        low, high = one[axis], one[axis]
        other_low, other_high = other[axis], other[axis]
        for i in (3 + axis, 6 + axis):
            low, high = min(low, one[i]), max(high, one[i])
            other_low, other_high = min(other_low, other[i]), max(other_high, other[i])
        if low >= other_high or high <= other_low:
            return True
    return False


@inlined
def add_pair(own, corners, width, work, sums, extremes):
    """Add up the differences over what two triangles share, the second one's less the first's."""
    polygons, counts, inside, other, sides = work
    if lie_apart(own, corners) or turn(corners) == 0.0:
        return
    if np.isnan(corners[2] + corners[5] + corners[8]):
        return
    n, _ = split(polygons, counts, 1, 0, corners, (0.0, 0.0), width, inside, other, sides)
    if n == 0:
        return
    slopes = gradient(corners)
    for i in range(n):
        sides[i] = height_on(corners, slopes, inside[i, 0], inside[i, 1]) - inside[i, 2]
    area = add_heights(inside, n, sides, sums)
    note_extremes(inside, n, sides, extremes)
    add_angles(area, slopes, gradient(own), sums, extremes)


@jit
def fill_first_polygon(corners, frame, polygons, counts, places):
    """Write a triangle as the first polygon, and the rows and columns of its corners."""
    for corner in range(3):
        for axis in range(3):
            polygons[0, corner, axis] = corners[3 * corner + axis]
        row, col = place_in(frame, corners[3 * corner], corners[3 * corner + 1])
        places[corner, 0], places[corner, 1] = row, col
    counts[0] = 3


@jit
def area_from_above(vertices, triangles):
    """Area of some triangles seen from above."""
    total = 0.0
    for triangle in triangles:
        total += 0.5 * abs(turn(corners_at(vertices, triangle)))
    return total


@jit
def add_differences(vertices, triangles, surface, frame, width, first, seen, sums, extremes):
    """Add up the differences between some triangles and the surface above and below them.

    ``seen`` holds for each triangle of a mesh the number of the last triangle that met it, as it
    may be in many cells; ``first`` is the number of the first one here.
    """
    heights, starts, members, _, _ = surface
    n_rows, n_cols = int(frame[N_ROWS]), int(frame[N_COLS])
    polygons, counts = np.empty((4, MOST_CORNERS, 3)), np.empty(4, np.int64)
    buffers = np.empty((2, MOST_CORNERS, 3))
    work = polygons, counts, buffers[0], buffers[1], np.empty(MOST_CORNERS)
    places, itself = np.empty((3, 2)), np.array([[0, 1, 2]])
    for number in range(triangles.shape[0]):
        own = corners_at(vertices, triangles[number])
        if turn(own) == 0.0:
            continue
        fill_first_polygon(own, frame, polygons, counts, places)
        first_row, last_row = rows_of_triangle(places, itself, 0, n_rows)
        for row in range(first_row, last_row + 1):
            left, right = cells_in_row(places, itself, 0, row, n_cols)
            for cell in range(row * n_cols + left, row * n_cols + right + 1):
                start, end = 2 * cell, 2 * cell + 2
                if heights.size == 0:
                    start, end = starts[cell], starts[cell + 1]
                for i in range(start, end):
                    met = i if heights.size > 0 else np.int64(members[i])
                    if heights.size == 0:
                        if seen[met] == first + number:
                            continue
                        seen[met] = first + number
                    add_pair(own, corners_of(surface, frame, met), width, work, sums, extremes)
