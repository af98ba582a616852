"""Points on surfaces, as Metro takes them (Cignoni, Rocchini and Scopigno, 1998).

Edges get a fixed number of points per unit of length and triangles per unit of area; what is left
of a point after an edge or a triangle is carried to the next one.
"""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.distance import half_cell

SUBDIVISION, SIMILAR, RANDOM = 0, 1, 2
DROPPED_BITS = 12  # of a float32, which leaves 11 of its digits: 0.05 %
N_BINS = 1 << (31 - DROPPED_BITS)

# --- a piece of a grid --------------------------------------------------------------------------


@jit
def is_half(heights, row, col, half):
    """Whether half a cell lies inside the grid and its three samples have heights."""
    if row < 0 or col < 0 or row >= heights.shape[0] - 1 or col >= heights.shape[1] - 1:
        return False
    corner_row, corner_col, end_row, side_col = half_cell(row, col, half)
    return not np.isnan(
        heights[corner_row, corner_col]
        + heights[corner_row, side_col]
        + heights[end_row, corner_col]
    )


@jit
def count_half_cells(heights, first_row, end_row):
    """How many triangles some rows of cells have."""
    n = 0
    for row in range(first_row, end_row):
        for col in range(heights.shape[1] - 1):
            n += is_half(heights, row, col, 0)
            n += is_half(heights, row, col, 1)
    return n


@jit
def is_corner(heights, row, col):
    """Whether a sample is the corner of a half cell with three heights."""
    for cell_row in range(row - 1, row + 1):
        for cell_col in range(col - 1, col + 1):
            for half in range(2):
                _, _, opposite_row, opposite_col = half_cell(cell_row, cell_col, half)
                is_far = row == opposite_row and col == opposite_col
                if not is_far and is_half(heights, cell_row, cell_col, half):
                    return True
    return False


@jit
def fill_samples_of_grid(heights, frame, first_row, end_row, vertices):
    """Write x, y and z of every sample of some rows."""
    for row in range(first_row, end_row):
        for col in range(heights.shape[1]):
            number = (row - first_row) * heights.shape[1] + col
            vertices[number, 0] = frame[0] + frame[2] * col + frame[4] * row
            vertices[number, 1] = frame[1] + frame[3] * col + frame[5] * row
            vertices[number, 2] = heights[row, col]


@jit
def fill_half_cells(heights, first_row, end_row, triangles):
    """Write the triangles of some rows of cells, counter-clockwise where rows run south.

    Vertices are numbered from the first sample of the first row on. Returns how many there are.
    """
    n_cols, n = heights.shape[1], 0
    for row in range(first_row, end_row):
        for col in range(n_cols - 1):
            for half in range(2):
                if is_half(heights, row, col, half):
                    corner_row, corner_col, end_row, side_col = half_cell(row, col, half)
                    beside = (corner_row - first_row) * n_cols + side_col
                    across = (end_row - first_row) * n_cols + corner_col
                    turned = (row + col) & 1 == 0
                    triangles[n, 0] = across if turned else beside
                    triangles[n, 1] = beside if turned else across
                    triangles[n, 2] = (corner_row - first_row) * n_cols + corner_col
                    n += 1
    return n


@jit
def fill_corners(heights, first_row, end_row, corners):
    """Write the numbers of the samples of some rows that have a triangle; return how many."""
    n_cols, n = heights.shape[1], 0
    for row in range(first_row, end_row):
        for col in range(n_cols):
            if is_corner(heights, row, col):
                corners[n] = (row - first_row) * n_cols + col
                n += 1
    return n


@jit
def fill_edges_of_cells(heights, first_row, end_row, edges):
    """Write both ends of each edge of some rows of cells once; return how many there are.

    The edge between two triangles is that of the one that comes first, by row, column and half.
    """
    n_cols, n = heights.shape[1], 0
    for row in range(first_row, end_row):
        for col in range(n_cols - 1):
            upper = (row - first_row) * n_cols + col
            lower = upper + n_cols
            slant = (row + col) & 1
            has_upper, has_lower = is_half(heights, row, col, 0), is_half(heights, row, col, 1)
            if has_upper or has_lower:
                edges[n, 0], edges[n, 1] = upper + slant, lower + 1 - slant
                n += 1
            if has_upper and not is_half(heights, row - 1, col, 1):
                edges[n, 0], edges[n, 1] = upper, upper + 1
                n += 1
            if has_lower:
                edges[n, 0], edges[n, 1] = lower, lower + 1
                n += 1
            for half in range(2):
                if not (has_lower if half == 1 else has_upper):
                    continue
                if half == slant:
                    edges[n, 0], edges[n, 1] = upper + 1, lower + 1
                    n += 1
                elif not is_half(heights, row, col - 1, half):
                    edges[n, 0], edges[n, 1] = upper, lower
                    n += 1
    return n


# --- lengths and areas --------------------------------------------------------------------------


@jit
def distance(vertices, a, b):
    """Distance between two vertices."""
    x, y = vertices[a, 0] - vertices[b, 0], vertices[a, 1] - vertices[b, 1]
    z = vertices[a, 2] - vertices[b, 2]
    return np.sqrt(x * x + y * y + z * z)


@jit
def area(vertices, a, b, c):
    """Area of a triangle in space."""
    px, py, pz = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    qx, qy, qz = (
        vertices[c, 0] - vertices[a, 0],
        vertices[c, 1] - vertices[a, 1],
        vertices[c, 2] - vertices[a, 2],
    )
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@jit
def total_area(vertices, triangles):
    """Area of some triangles."""
    total = 0.0
    for triangle in triangles:
        total += area(vertices, triangle[0], triangle[1], triangle[2])
    return total


@jit
def total_length(vertices, edges):
    """Length of some edges."""
    total = 0.0
    for edge in edges:
        total += distance(vertices, edge[0], edge[1])
    return total


# --- how many points ----------------------------------------------------------------------------


@jit
def count_on_edges(vertices, edges, per_length, owed, counts):
    """Write how many points each edge gets; ``owed`` is what edges before these left of one."""
    for number in range(edges.shape[0]):
        owed += distance(vertices, edges[number, 0], edges[number, 1]) * per_length
        counts[number] = int(owed)
        owed -= counts[number]


@jit
def halvings(n_points):
    """The logarithm of a number to base two, rounded down."""
    depth = 0
    while n_points >> (depth + 1) > 0:
        depth += 1
    return depth


@jit
def lattice_intervals(n_points):
    """Intervals along the sides of the regular lattice with at most so many points inside."""
    return int((np.sqrt(1.0 + 8.0 * n_points) + 5.0) / 2.0) - 1


@jit
def count_in_parts(areas, per_area, owed, method, counts, stands_for):
    """Write how many points each part of a triangle gets, and the area that each stands for.

    A part too small for a point of its own is counted to the next one that gets some, or else to
    the last one, so that all of them together stand for the whole. ``owed`` is what parts before
    these left of a point.
    """
    uncounted, last = 0.0, -1
    for number in range(areas.size):
        owed += areas[number] * per_area
        uncounted += areas[number]
        n_points = int(owed)
        if n_points > 0 and method == SUBDIVISION:
            n_points = 1 << halvings(n_points)
        if n_points > 0 and method == SIMILAR:
            n_sides = lattice_intervals(n_points)
            n_points = (n_sides - 1) * (n_sides - 2) // 2
        counts[number] = n_points
        if n_points > 0:
            stands_for[number] = uncounted / n_points
            owed, uncounted, last = owed - n_points, 0.0, number
    if last >= 0:
        stands_for[last] += uncounted / counts[last]


# --- parts of triangles -------------------------------------------------------------------------


@jit
def halve(part, half):
    """Halve a triangle at its longest edge: ``part`` becomes the one, ``half`` the other."""
    longest, tail = -1.0, 0
    for side in range(3):
        square = 0.0
        for axis in range(3):
            square += (part[3 * side + axis] - part[(3 * side + 3) % 9 + axis]) ** 2
        if square > longest:
            longest, tail = square, 3 * side
    head = (tail + 3) % 9
    for i in range(9):
        half[i] = part[i]
    for axis in range(3):
        middle = 0.5 * (part[tail + axis] + part[head + axis])
        part[tail + axis] = half[head + axis] = middle


@jit
def count_parts(vertices, triangles, largest):
    """How many parts no larger than an area some triangles make, halved again and again."""
    n = 0
    for triangle in triangles:
        n_parts, part_area = 1, area(vertices, triangle[0], triangle[1], triangle[2])
        while part_area > largest:
            n_parts, part_area = 2 * n_parts, 0.5 * part_area
        n += n_parts
    return n


@jit
def fill_parts(vertices, triangles, largest, parts, areas):
    """Write the corners of the parts, nine coordinates each, and their areas."""
    end = 0
    for triangle in triangles:
        first, end = end, end + 1
        for i in range(9):
            parts[first, i] = vertices[triangle[i // 3], i % 3]
        part_area = area(vertices, triangle[0], triangle[1], triangle[2])
        while part_area > largest:
            n_parts, part_area = end - first, 0.5 * part_area
            for part in range(first + n_parts - 1, first - 1, -1):
                target = first + 2 * (part - first)
                for i in range(9):
                    parts[target, i] = parts[part, i]
                halve(parts[target], parts[target + 1])
            end = first + 2 * n_parts
        areas[first:end] = part_area


# --- points -------------------------------------------------------------------------------------


@jit
def place_on_edges(vertices, edges, counts, points):
    """Write so many evenly spaced points inside each edge."""
    n = 0
    for number in range(edges.shape[0]):
        a, b = edges[number, 0], edges[number, 1]
        for i in range(1, counts[number] + 1):
            share = i / (counts[number] + 1)
            for axis in range(3):
                points[n, axis] = vertices[a, axis] + share * (
                    vertices[b, axis] - vertices[a, axis]
                )
            n += 1


@jit
def place_in_halves(corners, depth, points, waiting, depths):
    """Write the centres of a triangle's 2**depth parts, halved at the longest edge each time."""
    waiting[0, :], depths[0] = corners, depth
    n_waiting, n = 1, 0
    while n_waiting > 0:
        last = n_waiting - 1
        part = waiting[last]
        if depths[last] > 0:
            halve(part, waiting[n_waiting])
            depths[last] -= 1
            depths[n_waiting] = depths[last]
            n_waiting += 1
            continue
        for axis in range(3):
            points[n, axis] = (part[axis] + part[3 + axis] + part[6 + axis]) / 3.0
        n, n_waiting = n + 1, last


@jit
def place_on_lattice(corners, n_points, points):
    """Write so many points of a regular lattice inside a triangle."""
    n_sides = lattice_intervals(n_points)
    n = 0
    for i in range(1, n_sides):
        for j in range(1, n_sides - i):
            for axis in range(3):
                along = i * (corners[3 + axis] - corners[axis])
                across = j * (corners[6 + axis] - corners[axis])
                points[n, axis] = corners[axis] + (along + across) / n_sides
            n += 1


@jit
def place_at_random(corners, rolls, points):
    """Write points of a triangle, evenly distributed where the rolls are: two for each point."""
    for n in range(rolls.shape[0]):
        one, other = rolls[n, 0], rolls[n, 1]
        if one + other > 1.0:
            one, other = 1.0 - one, 1.0 - other
        for axis in range(3):
            along = one * (corners[3 + axis] - corners[axis])
            across = other * (corners[6 + axis] - corners[axis])
            points[n, axis] = corners[axis] + along + across


@jit
def place_in_parts(parts, counts, stands_for, method, rolls, points, areas):
    """Write the points of each part, and the area that each stands for."""
    waiting, depths = np.empty((64, 9)), np.empty(64, np.int64)
    n = 0
    for number in range(parts.shape[0]):
        n_points = counts[number]
        if n_points == 0:
            continue
        own = points[n : n + n_points]
        if method == SUBDIVISION:
            place_in_halves(parts[number], halvings(n_points), own, waiting, depths)
        elif method == SIMILAR:
            place_on_lattice(parts[number], n_points, own)
        else:
            place_at_random(parts[number], rolls[n : n + n_points], own)
        areas[n : n + n_points] = stands_for[number]
        n += n_points


# --- what they say ------------------------------------------------------------------------------


@jit
def summarise(squares, weights, histogram):
    """Sums of d, d², weight, weight · d and weight · d², the largest d and its place.

    ``squares`` holds d², and then d. The histogram counts distances by the upper bits of a
    float32, which are those of their logarithm.
    """
    sums = np.zeros(5)
    worst = 0
    single = np.empty(1, np.float32)
    bits = single.view(np.int32)
    for i in range(squares.size):
        square, weight = squares[i], weights[i]
        value = np.sqrt(square)
        sums[0] += value
        sums[1] += square
        sums[2] += weight
        sums[3] += weight * value
        sums[4] += weight * square
        if square > squares[worst]:
            worst = i
    for i in range(squares.size):
        squares[i] = np.sqrt(squares[i])
        single[0] = squares[i]
        histogram[bits[0] >> DROPPED_BITS] += 1
    return sums, worst
