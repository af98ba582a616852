r"""Distances from points to surfaces, exact up to the rounding of float64.

A surface lies over a frame of equal cells, and each cell knows its triangles. In a grid these are
its two halves, the finest triangles of the lattice::

    row + col even  +--+   odd  +--+     half 0 has the upper right corner,
                    |\ |        | /|     or the upper left one; half 1 the
                    | \|        |/ |     one opposite
                    +--+        +--+

In a mesh a list for each cell names the triangles above and below it. A search looks at the cells
around a point that may hold something nearer than what it knows. Where these are many it goes
through blocks of 8 × 8, 16 × 16, … cells, nearest first, and leaves out those that are too far
away, or too far above or below.
"""

import numpy as np

from rtin._kernels._jit import inlined, jit

BLOCK = 8  # cells a side of the smallest blocks
FEW = 16  # cells that are looked at without going through blocks
MARGIN = 1e-9  # of a cell, that places in the frame may be rounded by
SLIM = 1e-6  # sine at a corner, squared, that leaves too few digits of the product of two sides
FLAT = 1e-30  # height over a side, squared, in units of another side, that is all rounding

# A frame is an array: x and y of its origin, of a step of one column and of one row; what brings
# x and y back to columns and to rows; and, at these places:
COLUMN_WIDTH, ROW_WIDTH, IS_SKEW, N_ROWS, N_COLS = 10, 11, 12, 13, 14

# --- a triangle ---------------------------------------------------------------------------------


@jit
def segment_square(px, py, pz, ax, ay, az, bx, by, bz):
    """Squared distance from a point to the segment from a to b, which may be a point."""
    abx, aby, abz = bx - ax, by - ay, bz - az
    apx, apy, apz = px - ax, py - ay, pz - az
    length = abx * abx + aby * aby + abz * abz
    share = 0.0
    if length > 0.0:
        share = min(max((abx * apx + aby * apy + abz * apz) / length, 0.0), 1.0)
    x, y, z = apx - share * abx, apy - share * aby, apz - share * abz
    return x * x + y * y + z * z


@jit
def slim_square(apx, apy, apz, abx, aby, abz, acx, acy, acz):
    """Squared distance to the inside of a slim triangle from above or below it; inf elsewhere.

    The vectors are those from a corner. The height over ab is made upright to it twice: the foot is
    then that in a triangle whose third corner is off by no more than the rounding of its place,
    while the product of two sides would tilt by far more.
    """
    ab, ac = abx * abx + aby * aby + abz * abz, acx * acx + acy * acy + acz * acz
    if ab == 0.0:
        return np.inf
    along = (acx * abx + acy * aby + acz * abz) / ab
    hx, hy, hz = acx - along * abx, acy - along * aby, acz - along * abz
    rest = (hx * abx + hy * aby + hz * abz) / ab
    hx, hy, hz = hx - rest * abx, hy - rest * aby, hz - rest * abz
    height = hx * hx + hy * hy + hz * hz
    if height <= FLAT * ac:
        return np.inf
    of_ab = (apx * abx + apy * aby + apz * abz) / ab
    of_c = (apx * hx + apy * hy + apz * hz) / height
    of_b = of_ab - of_c * (along + rest)
    if of_b < 0.0 or of_c < 0.0 or of_b + of_c > 1.0:
        return np.inf
    x, y = apx - of_ab * abx - of_c * hx, apy - of_ab * aby - of_c * hy
    z = apz - of_ab * abz - of_c * hz
    return x * x + y * y + z * z


@jit
def triangle_square(px, py, pz, ax, ay, az, bx, by, bz, cx, cy, cz, enough):
    """Squared distance from a point to a triangle, which may be flat; inf where it is ``enough``.

    By the region that the point is nearest to: a corner, a side, or the inside (Ericson,
    "Real-Time Collision Detection", 2005, §5.1.5).
    """
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    normal = nx * nx + ny * ny + nz * nz
    ab, ac = abx * abx + aby * aby + abz * abz, acx * acx + acy * acy + acz * acz
    apx, apy, apz = px - ax, py - ay, pz - az
    if normal <= SLIM * ab * ac:
        to_ab = segment_square(px, py, pz, ax, ay, az, bx, by, bz)
        to_bc = segment_square(px, py, pz, bx, by, bz, cx, cy, cz)
        to_ca = segment_square(px, py, pz, cx, cy, cz, ax, ay, az)
        to_inside = slim_square(apx, apy, apz, abx, aby, abz, acx, acy, acz)
        return min(to_ab, to_bc, to_ca, to_inside)
    height = nx * apx + ny * apy + nz * apz
    if height * height >= enough * normal:
        return np.inf
    # Barycentric coordinates of the foot, times the squared normal.
    of_b = (
        nx * (apy * acz - apz * acy) + ny * (apz * acx - apx * acz) + nz * (apx * acy - apy * acx)
    )
    of_c = (
        nx * (aby * apz - abz * apy) + ny * (abz * apx - abx * apz) + nz * (abx * apy - aby * apx)
    )
    if of_b > 0.0 and of_c > 0.0 and of_b + of_c < normal:
        return height * height / normal
    square = np.inf
    if of_c <= 0.0:
        square = segment_square(px, py, pz, ax, ay, az, bx, by, bz)
    if of_b <= 0.0:
        square = min(square, segment_square(px, py, pz, ax, ay, az, cx, cy, cz))
    if of_b + of_c >= normal:
        square = min(square, segment_square(px, py, pz, bx, by, bz, cx, cy, cz))
    return square


@jit
def square_to(point_x, point_y, point_z, vertices, triangles, triangle, enough):
    """Squared distance from a point to a triangle of a mesh; inf where it is ``enough``."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    return triangle_square(
        point_x,
        point_y,
        point_z,
        vertices[a, 0],
        vertices[a, 1],
        vertices[a, 2],
        vertices[b, 0],
        vertices[b, 1],
        vertices[b, 2],
        vertices[c, 0],
        vertices[c, 1],
        vertices[c, 2],
        enough,
    )


# --- a grid -------------------------------------------------------------------------------------


@jit
def half_cell(row, col, half):
    """Row and column of half a cell's right angle, and the other row and the other column of it."""
    corner_row, corner_col = row + half, col + (half ^ ((row + col) & 1) ^ 1)
    return corner_row, corner_col, 2 * row + 1 - corner_row, 2 * col + 1 - corner_col


@jit
def corners_of_half(heights, frame, row, col, half):
    """Nine coordinates of half a cell: of its right angle, and beside and below or above that."""
    corner_row, corner_col, end_row, side_col = half_cell(row, col, half)
    x0, y0, ux, uy, vx, vy = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    return (
        x0 + ux * corner_col + vx * corner_row,
        y0 + uy * corner_col + vy * corner_row,
        np.float64(heights[corner_row, corner_col]),  # differences of float32 would be rounded
        x0 + ux * side_col + vx * corner_row,
        y0 + uy * side_col + vy * corner_row,
        np.float64(heights[corner_row, side_col]),
        x0 + ux * corner_col + vx * end_row,
        y0 + uy * corner_col + vy * end_row,
        np.float64(heights[end_row, corner_col]),
    )


@jit
def cell_square(px, py, pz, heights, frame, row, col, half, enough):
    """Squared distance from a point to half a cell; inf where it is ``enough`` or has a void."""
    ax, ay, az, bx, by, bz, cx, cy, cz = corners_of_half(heights, frame, row, col, half)
    if np.isnan(az + bz + cz):
        return np.inf
    return triangle_square(px, py, pz, ax, ay, az, bx, by, bz, cx, cy, cz, enough)


@jit
def fill_block_ranges(heights, first, end, lows, highs):
    """Write the lowest and highest samples of the smallest blocks of some rows of blocks."""
    n_rows, n_cols = heights.shape
    for block_row in range(first, end):
        for block_col in range(lows.shape[1]):
            low, high = np.inf, -np.inf
            for row in range(block_row * BLOCK, min((block_row + 1) * BLOCK + 1, n_rows)):
                for col in range(block_col * BLOCK, min((block_col + 1) * BLOCK + 1, n_cols)):
                    height = heights[row, col]
                    if height < low:
                        low = height
                    if height > high:
                        high = height
            lows[block_row, block_col], highs[block_row, block_col] = low, high


# --- a mesh -------------------------------------------------------------------------------------


@jit
def columns_in_strip(top, bottom, ay, ax, by, bx, left, right):
    """Widen left and right to the edge from a to b between two rows, if it gets there."""
    if max(ay, by) < top or min(ay, by) > bottom:
        return left, right
    for y, x in ((ay, ax), (by, bx)):
        if top <= y <= bottom:
            left, right = min(left, x), max(right, x)
    for y in (top, bottom):
        if (ay < y) != (by < y):
            x = ax + (bx - ax) * ((y - ay) / (by - ay))
            left, right = min(left, x), max(right, x)
    return left, right


@jit
def cells_in_row(places, triangles, triangle, row, n_cols):
    """First and last cell of a row that a triangle may reach into; first > last for none."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    top, bottom = row - MARGIN, row + 1 + MARGIN
    left, right = np.inf, -np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        left, right = columns_in_strip(
            top,
            bottom,
            places[start, 0],
            places[start, 1],
            places[end, 0],
            places[end, 1],
            left,
            right,
        )
    if left > right:
        return 1, 0
    return max(0, int(left - MARGIN)), min(n_cols - 1, int(right + MARGIN))


@jit
def rows_of_triangle(places, triangles, triangle, n_rows):
    """First and last row of cells that a triangle reaches into."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    top = min(places[a, 0], places[b, 0], places[c, 0])
    bottom = max(places[a, 0], places[b, 0], places[c, 0])
    return max(0, int(top - MARGIN)), min(n_rows - 1, int(bottom + MARGIN))


@jit
def count_members(places, triangles, starts, n_rows, n_cols):
    """Write how many triangles reach into each cell, one place further on."""
    for triangle in range(triangles.shape[0]):
        first, last = rows_of_triangle(places, triangles, triangle, n_rows)
        for row in range(first, last + 1):
            left, right = cells_in_row(places, triangles, triangle, row, n_cols)
            for col in range(left, right + 1):
                starts[row * n_cols + col + 1] += 1


@jit
def fill_members(vertices, places, triangles, ends, members, n_rows, n_cols, lows, highs):
    """Write the triangles of each cell from where it starts, and the blocks' ranges of heights.

    ``ends`` holds where each cell's list starts, and then where it ends.
    """
    for triangle in range(triangles.shape[0]):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        low = min(vertices[a, 2], vertices[b, 2], vertices[c, 2])
        high = max(vertices[a, 2], vertices[b, 2], vertices[c, 2])
        first, last = rows_of_triangle(places, triangles, triangle, n_rows)
        for row in range(first, last + 1):
            left, right = cells_in_row(places, triangles, triangle, row, n_cols)
            for col in range(left, right + 1):
                members[ends[row * n_cols + col]] = triangle
                ends[row * n_cols + col] += 1
            for block in range(left // BLOCK, right // BLOCK + 1):
                if low < lows[row // BLOCK, block]:
                    lows[row // BLOCK, block] = low
                if high > highs[row // BLOCK, block]:
                    highs[row // BLOCK, block] = high


# --- the search ---------------------------------------------------------------------------------


@jit
def place_in(frame, x, y):
    """Row and column, with fractions, of a place in a frame."""
    x, y = x - frame[0], y - frame[1]
    return frame[8] * x + frame[9] * y, frame[6] * x + frame[7] * y


@jit
def cell_number(place, n_cells):
    """Row or column of the cell at, or nearest to, a place."""
    return int(min(max(place, 0.0), n_cells - 1.0))


@jit
def gap(place, first, end):
    """Cells between a place and the cells from first to before end; none where they are close."""
    return max(first - place - MARGIN, place - end - MARGIN, 0.0)


@jit
def gap_square(rows, cols, frame):
    """Squared length, at least, of a step of so many rows and columns."""
    x, y = cols * frame[COLUMN_WIDTH], rows * frame[ROW_WIDTH]
    return max(x * x, y * y) if frame[IS_SKEW] != 0.0 else x * x + y * y


@jit
def nearest_in_cell(px, py, pz, surface, frame, row, col, best, found):
    """Squared distance to what is nearer in a cell, and its number; ``best, found`` if nothing."""
    heights, starts, members, vertices, triangles = surface
    if heights.size > 0:
        for half in range(2):
            square = cell_square(px, py, pz, heights, frame, row, col, half, best)
            if square < best:
                best, found = square, 2 * (row * (heights.shape[1] - 1) + col) + half
        return best, found
    cell = row * int(frame[N_COLS]) + col
    for i in range(starts[cell], starts[cell + 1]):
        square = square_to(px, py, pz, vertices, triangles, members[i], best)
        if square < best:
            best, found = square, np.int64(members[i])
    return best, found


@jit
def height_gap_square(pz, heights, row, col):
    """Squared distance, at least, upright to a cell of a grid; 0 to one of a mesh."""
    if heights.size == 0:
        return 0.0
    a, b = heights[row, col], heights[row, col + 1]
    c, d = heights[row + 1, col], heights[row + 1, col + 1]
    if np.isnan(a + b + c + d):
        return 0.0
    up = max(min(a, b, c, d) - pz, pz - max(a, b, c, d), 0.0)
    return up * up


@jit
def nearest_in_cells(point, surface, frame, at, cells, best, found):
    """The same for the cells of some rows and columns."""
    px, py, pz = point
    row_at, col_at = at
    first_row, end_row, first_col, end_col = cells
    for row in range(first_row, end_row):
        rows = gap(row_at, row, row + 1)
        if gap_square(rows, 0.0, frame) < best:
            for col in range(first_col, end_col):
                square = gap_square(rows, gap(col_at, col, col + 1), frame)
                square += height_gap_square(pz, surface[0], row, col)
                if square < best:
                    best, found = nearest_in_cell(px, py, pz, surface, frame, row, col, best, found)
    return best, found


@jit
def cells_within(at, square, frame):
    """First and end row and column of the cells within a distance of a place."""
    row_at, col_at = at
    n_rows, n_cols = int(frame[N_ROWS]), int(frame[N_COLS])
    reach = np.sqrt(square)
    rows, cols = reach / frame[ROW_WIDTH] + MARGIN, reach / frame[COLUMN_WIDTH] + MARGIN
    return (
        cell_number(row_at - rows, n_rows),
        cell_number(row_at + rows, n_rows) + 1,
        cell_number(col_at - cols, n_cols),
        cell_number(col_at + cols, n_cols) + 1,
    )


@jit
def block_square(pz, at, frame, block, ranges, levels):
    """Squared distance, at least, from a point to what a block holds; inf for nothing."""
    level, row, col = block >> 56, (block >> 28) & 0xFFFFFFF, block & 0xFFFFFFF
    number = levels[level, 0] + row * levels[level, 2] + col
    side = BLOCK << level
    up = max(ranges[number, 0] - pz, pz - ranges[number, 1], 0.0)
    rows = gap(at[0], row * side, (row + 1) * side)
    cols = gap(at[1], col * side, (col + 1) * side)
    return gap_square(rows, cols, frame) + up * up


@jit
def nearest_through_blocks(point, surface, frame, blocks, at, waiting, bounds, best, found):
    """The same for all cells, going through blocks."""
    ranges, levels = blocks
    top = levels.shape[0] - 1
    waiting[0] = top << 56
    bounds[0] = block_square(point[2], at, frame, waiting[0], ranges, levels)
    n_waiting = 1
    while n_waiting > 0:
        n_waiting -= 1
        block = waiting[n_waiting]
        if bounds[n_waiting] >= best:
            continue
        level, row, col = block >> 56, (block >> 28) & 0xFFFFFFF, block & 0xFFFFFFF
        if level == 0:
            first_row, end_row, first_col, end_col = cells_within(at, best, frame)
            cells = (
                max(first_row, row * BLOCK),
                min(end_row, (row + 1) * BLOCK),
                max(first_col, col * BLOCK),
                min(end_col, (col + 1) * BLOCK),
            )
            best, found = nearest_in_cells(point, surface, frame, at, cells, best, found)
            continue
        side = BLOCK << (level - 1)
        nearest = int(at[0] >= (2 * row + 1) * side) << 1 | int(at[1] >= (2 * col + 1) * side)
        for k in range(3, -1, -1):  # what comes last is looked at first
            child_row, child_col = 2 * row + ((nearest ^ k) >> 1), 2 * col + ((nearest ^ k) & 1)
            if child_row < levels[level - 1, 1] and child_col < levels[level - 1, 2]:
                child = (level - 1) << 56 | child_row << 28 | child_col
                bound = block_square(point[2], at, frame, child, ranges, levels)
                if bound < best:
                    waiting[n_waiting], bounds[n_waiting] = child, bound
                    n_waiting += 1
    return best, found


@inlined
def nearest_to_point(point, surface, frame, blocks, waiting, bounds):
    """Squared distance from a point to a surface, and the number of a nearest triangle.

    It starts from the cell below or above the point, or nearest to it.
    """
    at = place_in(frame, point[0], point[1])
    row, col = cell_number(at[0], int(frame[N_ROWS])), cell_number(at[1], int(frame[N_COLS]))
    best, found = nearest_in_cell(
        point[0], point[1], point[2], surface, frame, row, col, np.inf, -1
    )
    cells = cells_within(at, best, frame)
    n_cells = (cells[1] - cells[0]) * (cells[3] - cells[2])
    if n_cells > FEW:
        return nearest_through_blocks(
            point, surface, frame, blocks, at, waiting, bounds, best, found
        )
    if n_cells > 1:
        return nearest_in_cells(point, surface, frame, at, cells, best, found)
    return best, found


@jit
def nearest_on_surface(points, surface, frame, blocks, squares, nearest):
    """Write each point's squared distance to a surface, and the number of a nearest triangle."""
    waiting, bounds = np.empty(128, np.int64), np.empty(128)
    for i in range(points.shape[0]):
        point = points[i, 0], points[i, 1], points[i, 2]
        squares[i], nearest[i] = nearest_to_point(point, surface, frame, blocks, waiting, bounds)


# --- by number ----------------------------------------------------------------------------------


@jit
def corners_at(vertices, triangle):
    """Nine coordinates of a triangle of vertices."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    return (
        vertices[a, 0],
        vertices[a, 1],
        vertices[a, 2],
        vertices[b, 0],
        vertices[b, 1],
        vertices[b, 2],
        vertices[c, 0],
        vertices[c, 1],
        vertices[c, 2],
    )


@jit
def corners_of(surface, frame, number):
    """Nine coordinates of the triangle of that number; some are NaN at a void of a grid."""
    heights, _, _, vertices, triangles = surface
    if heights.size == 0:
        return corners_at(vertices, triangles[number])
    row, col = divmod(number >> 1, heights.shape[1] - 1)
    return corners_of_half(heights, frame, row, col, number & 1)
