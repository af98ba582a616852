"""Convex polygons cut by straight lines, seen from above.

A polygon is an array of corners x, y and z, in either order around it; what is cut keeps its
slopes. I. E. Sutherland and G. W. Hodgman, "Reentrant polygon clipping", Communications of the
ACM 17(1), 1974.
"""

import numpy as np

from rtin._kernels._jit import jit

MOST_CORNERS = 16


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
