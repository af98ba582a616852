"""Arithmetic of the coarsening: what a triangle that does not fit entails, and the mesh of it.

``kept`` holds a byte for each sample of the lattice, not 0 where the vertex is kept. Two rules say
which vertices the least mesh keeps, and no others:

    closure     a kept vertex keeps both its apexes
    criterion   a kept apex whose triangle does not fit keeps the midpoint of its hypotenuse

They only ever add, so any order, and any split of the rows among threads, ends in the same mesh.

Where squares may be swapped, the criterion is weaker: where the other diagonal fits, it keeps both
apexes of the midpoint only. ``swapped`` then holds a byte for each sample, not 0 where the square
around it takes its other diagonal unless the vertex is kept in the end; else it is None.
"""

import heapq

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.criteria import row_errors
from rtin._kernels.diagonals import (
    is_on_other_diagonal,
    is_swapped,
    other_diagonal_error,
    remedy,
)
from rtin._kernels.lattice import (
    SQUARE,
    VERTEX,
    apexes,
    direction_of,
    hypotenuse,
    is_centre,
    is_inside,
    is_unit,
    midpoint,
    packed,
    spacing_of,
    unpacked,
)
from rtin._kernels.planes import (
    midpoint_fails,
    triangle_error,
    triangle_fails,
    triangle_fails_or_is_mixed,
)

KEPT, USED = 1, 3


# --- the least mesh -----------------------------------------------------------------------------


@jit
def with_room(array, n_needed):
    """The array, or a copy at least twice as long where it is too short."""
    if n_needed <= array.size:
        return array
    larger = np.empty(max(n_needed, 2 * array.size), array.dtype)
    larger[: array.size] = array
    return larger


@jit
def is_open(kept, first_row, end_row, row, col):
    """Whether a vertex of the lattice is still to be kept, as far as these rows can tell."""
    size = kept.shape[0] - 1
    return is_inside(row, col, size) and not (first_row <= row < end_row and kept[row, col] != 0)


@jit
def push_apexes(kept, first_row, end_row, row, col, stack, n_stack):
    """Put both apexes of a vertex on the stack, where they are still to be kept."""
    p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
    if is_open(kept, first_row, end_row, p_row, p_col):
        stack[n_stack] = packed(p_row, p_col, VERTEX)
        n_stack += 1
    if is_open(kept, first_row, end_row, q_row, q_col):
        stack[n_stack] = packed(q_row, q_col, VERTEX)
        n_stack += 1
    return n_stack


@jit
def mark(kept, swapped, row, col, kind):
    """Note that a vertex is kept, or that the square around it is swapped."""
    if swapped is not None and kind == SQUARE:
        swapped[row, col] = 1
    else:
        kept[row, col] = 1


@jit
def settle(
    heights,
    is_complete,
    max_error,
    tolerance,
    kept,
    swapped,
    first_row,
    end_row,
    finest,
    remembers,
    work,
):
    """Apply both rules to the rows first_row to end_row until nothing changes there.

    ``work`` lists triangles to test, vertices to keep and squares to swap. Returns those of the
    latter two that lie in other rows; the triangles whose apex has a spacing below ``finest``, left
    untested; and, where it ``remembers``, the triangles that fit.
    """
    stack, n_stack = np.empty(work.size + 64, np.int64), work.size
    stack[:n_stack] = work
    elsewhere, n_elsewhere = np.empty(64, np.int64), 0
    untested, n_untested = np.empty(64, np.int64), 0
    fitting, n_fitting = np.empty(64, np.int64), 0
    while n_stack > 0:
        n_stack -= 1
        row, col, first = unpacked(stack[n_stack])
        end = first + 1
        if first >= VERTEX:
            if not first_row <= row < end_row:
                elsewhere = with_room(elsewhere, n_elsewhere + 1)
                elsewhere[n_elsewhere] = stack[n_stack]
                n_elsewhere += 1
                continue
            if kept[row, col] != 0:
                continue
            mark(kept, swapped, row, col, first)
            stack = with_room(stack, n_stack + 6)
            n_stack = push_apexes(kept, first_row, end_row, row, col, stack, n_stack)
            if first == SQUARE:
                continue
            first, end = 0, 4
        spacing = spacing_of(row, col)
        if is_unit(row, col, spacing):
            continue
        if spacing < finest:
            untested = with_room(untested, n_untested + 4)
            for direction in range(first, end):
                untested[n_untested] = packed(row, col, direction)
                n_untested += 1
            continue
        stack = with_room(stack, n_stack + 4)
        along_axis = is_centre(row, col, spacing)
        for direction in range(first, end):
            mid_row, mid_col = midpoint(row, col, spacing, direction)
            if not is_open(kept, first_row, end_row, mid_row, mid_col):
                continue
            if is_swapped(swapped, first_row, end_row, mid_row, mid_col):
                continue
            # One call that holds these three took 15 ns more for each triangle than its answer.
            fails = midpoint_fails(heights, max_error, tolerance, row, col, spacing, direction)
            if not fails and not is_complete:
                fails = triangle_fails_or_is_mixed(
                    heights, max_error, tolerance, row, col, spacing, direction
                )
            elif not fails and spacing > 1:
                fails = triangle_fails(
                    heights, max_error, tolerance, row, col, spacing, direction, along_axis
                )
            if fails:
                kind = remedy(heights, max_error, tolerance, swapped, mid_row, mid_col)
                stack[n_stack] = packed(mid_row, mid_col, kind)
                n_stack += 1
            elif remembers:
                fitting = with_room(fitting, n_fitting + 1)
                fitting[n_fitting] = packed(row, col, direction)
                n_fitting += 1
    return elsewhere[:n_elsewhere], untested[:n_untested], fitting[:n_fitting]


# --- the closure --------------------------------------------------------------------------------


@jit
def close(kept, first_row, end_row, stack, n_stack, elsewhere, n_elsewhere):
    """Keep the vertices on the stack and all they need; append what they need of other rows."""
    while n_stack > 0:
        n_stack -= 1
        row, col, _ = unpacked(stack[n_stack])
        if not first_row <= row < end_row:
            elsewhere = with_room(elsewhere, n_elsewhere + 1)
            elsewhere[n_elsewhere] = packed(row, col, VERTEX)
            n_elsewhere += 1
            continue
        kept[row, col] = 1
        stack = with_room(stack, n_stack + 2)
        n_stack = push_apexes(kept, first_row, end_row, row, col, stack, n_stack)
    return elsewhere, n_elsewhere


@jit
def close_all(kept, work):
    """Keep the vertices in ``work``, and all they need."""
    close(kept, 0, kept.shape[0], work, work.size, work, 0)


@jit
def keep_marked(kept, first_row, end_row, row, marks, stack, elsewhere, n_elsewhere):
    """Keep the marked vertices of a row, and all they need."""
    words = marks.view(np.uint64)
    for word in range(words.size):
        if words[word] == 0:
            continue
        for col in range(8 * word, 8 * word + 8):
            if marks[col] != 0 and kept[row, col] == 0:
                stack[0] = packed(row, col, VERTEX)
                elsewhere, n_elsewhere = close(
                    kept, first_row, end_row, stack, 1, elsewhere, n_elsewhere
                )
    return elsewhere, n_elsewhere


@jit
def keep_by_threshold(heights, size, threshold, kept, first_row, end_row):
    """Keep the vertices of some rows where E(v) is not less than the threshold, and their parents.

    Returns what these need of other rows.
    """
    n_cols = heights.shape[1]
    errors = np.empty(n_cols, np.float64)
    marks = np.zeros(8 * ((n_cols + 7) // 8), np.uint8)
    stack, elsewhere, n_elsewhere = np.empty(160, np.int64), np.empty(64, np.int64), 0
    for row in range(first_row, min(end_row, heights.shape[0])):
        row_errors(heights, size, row, errors)
        for col in range(n_cols):
            marks[col] = errors[col] >= threshold
        elsewhere, n_elsewhere = keep_marked(
            kept, first_row, end_row, row, marks, stack, elsewhere, n_elsewhere
        )
    return elsewhere[:n_elsewhere]


@jit
def keep_by_mask(mask, kept, first_row, end_row):
    """Keep the vertices of some rows where the mask is True, and their parents.

    Returns what these need of other rows.
    """
    n_cols = mask.shape[1]
    marks = np.zeros(8 * ((n_cols + 7) // 8), np.uint8)
    stack, elsewhere, n_elsewhere = np.empty(160, np.int64), np.empty(64, np.int64), 0
    for row in range(first_row, min(end_row, mask.shape[0])):
        marks[:n_cols] = mask[row]
        elsewhere, n_elsewhere = keep_marked(
            kept, first_row, end_row, row, marks, stack, elsewhere, n_elsewhere
        )
    return elsewhere[:n_elsewhere]


# --- budgets ------------------------------------------------------------------------------------


@jit
def keep_with_closure(kept, stack, n_stack, added, n_added):
    """Keep the vertices on the stack and all they need; append each new one to ``added``."""
    while n_stack > 0:
        n_stack -= 1
        row, col, _ = unpacked(stack[n_stack])
        if kept[row, col] != 0:
            continue
        kept[row, col] = 1
        stack = with_room(stack, n_stack + 2)
        added = with_room(added, n_added + 1)
        added[n_added] = packed(row, col, VERTEX)
        n_added += 1
        n_stack = push_apexes(kept, 0, kept.shape[0], row, col, stack, n_stack)
    return added, n_added


@jit
def triangles_gained(row, col, n_rows, n_cols):
    """How many triangles more a newly kept vertex makes: one for each apex inside the raster."""
    p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
    gained = int(0 <= p_row < n_rows and 0 <= p_col < n_cols)
    return gained + int(0 <= q_row < n_rows and 0 <= q_col < n_cols)


@jit
def push_triangles(heap, heights, kept, row, col):
    """Put the triangles around a kept vertex on the heap, worst first."""
    size = kept.shape[0] - 1
    n_rows, n_cols = heights.shape
    spacing = spacing_of(row, col)
    if spacing == 0 or is_unit(row, col, spacing):
        return
    for direction in range(4):
        mid_row, mid_col = midpoint(row, col, spacing, direction)
        if not is_inside(mid_row, mid_col, size) or kept[mid_row, mid_col] != 0:
            continue
        a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing, direction)
        # After the voids are split off, a triangle with a void corner has no valid sample at all.
        if max(a_row, b_row) >= n_rows or max(a_col, b_col) >= n_cols:
            continue
        if np.isnan(heights[a_row, a_col]):
            continue
        along_axis = is_centre(row, col, spacing)
        error = triangle_error(heights, row, col, spacing, direction, along_axis)
        if error > 0.0:
            heapq.heappush(heap, (-error, packed(row, col, direction)))


@jit
def swap_instead(heights, swapped, heap, row, col, error):
    """Swap the square around a vertex if its other diagonal has no more error; say whether it has.

    The heap gets the vertex, to be kept when that error is too much as well.
    """
    if swapped is None:
        return False
    other_error = other_diagonal_error(heights, row, col, error)
    if other_error == np.inf:
        return False
    swapped[row, col] = 1
    if other_error > 0.0:
        heapq.heappush(heap, (-other_error, packed(row, col, VERTEX)))
    return True


@jit
def undo(marks, items):
    """Take back the marks of some vertices."""
    for item in items:
        row, col, _ = unpacked(item)
        marks[row, col] = 0


@jit
def split_worst_first(
    heights, kept, swapped, apex_items, n_vertices, n_triangles, max_vertices, max_triangles
):
    """Split the worst triangle, or swap its square, again and again while the budgets last.

    ``apex_items`` lists the kept vertices, ``n_vertices`` and ``n_triangles`` count their mesh.
    The mesh is one of the least ones whenever the worst triangle left is better than all split
    before; ``kept`` and ``swapped`` are left at the last such mesh within the budgets. Returns the
    tolerance of which it is the least mesh.
    """
    n_rows, n_cols = heights.shape
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for item in apex_items:
        row, col, _ = unpacked(item)
        push_triangles(heap, heights, kept, row, col)
    stack = np.empty(256, np.int64)
    added, n_added, n_least = np.empty(1024, np.int64), 0, 0
    turned, n_turned, n_least_turned = np.empty(64, np.int64), 0, 0
    reached = np.inf
    while len(heap) > 0:
        error, item = heapq.heappop(heap)
        row, col, direction = unpacked(item)
        if direction != VERTEX:
            row, col = midpoint(row, col, spacing_of(row, col), direction)
            if is_swapped(swapped, 0, len(kept), row, col):
                continue
        if kept[row, col] != 0:
            continue
        if -error < reached:
            reached, n_least, n_least_turned = -error, n_added, n_turned
        first_new = n_added
        stack[0], n_stack = packed(row, col, VERTEX), 1
        if direction != VERTEX and swap_instead(heights, swapped, heap, row, col, -error):
            turned = with_room(turned, n_turned + 1)
            turned[n_turned] = stack[0]
            n_turned += 1
            n_stack = push_apexes(kept, 0, len(kept), row, col, stack, 0)
        added, n_added = keep_with_closure(kept, stack, n_stack, added, n_added)
        for i in range(first_new, n_added):
            row, col, _ = unpacked(added[i])
            n_triangles += triangles_gained(row, col, n_rows, n_cols)
        n_vertices += n_added - first_new
        if n_vertices > max_vertices or n_triangles > max_triangles:
            break
        for i in range(first_new, n_added):
            row, col, _ = unpacked(added[i])
            push_triangles(heap, heights, kept, row, col)
    else:
        reached, n_least, n_least_turned = 0.0, n_added, n_turned
    undo(kept, added[n_least:n_added])
    if swapped is not None:
        undo(swapped, turned[n_least_turned:n_turned])
    return reached


# --- the mesh of a closed set -------------------------------------------------------------------


@jit
def is_valid(heights, row, col):
    """Whether there is a sample with a height at that place of the lattice."""
    return row < heights.shape[0] and col < heights.shape[1] and not np.isnan(heights[row, col])


@jit
def leaf_directions(kept, row, col, spacing):
    """Directions, as bits, in which a kept apex has a triangle that is not split."""
    size = kept.shape[0] - 1
    if is_unit(row, col, spacing) and 0 < row < size and 0 < col < size:
        return 15
    directions = 0
    if 0 < row < size and 0 < col < size:
        # Without branches: whether a triangle is split is beyond prediction.
        for direction in range(4):
            mid_row, mid_col = midpoint(row, col, spacing, direction)
            directions |= (kept[mid_row, mid_col] == 0) << direction
    elif spacing > 0 and not is_centre(row, col, spacing):
        for direction in range(4):
            row_step, col_step = direction_of(direction)
            mid_row, mid_col = midpoint(row, col, spacing, direction)
            if is_inside(row + row_step, col + col_step, size):
                is_leaf = spacing == 1 or kept[mid_row, mid_col] == 0
                directions |= is_leaf << direction
    return directions


@jit
def present_directions(heights, is_complete, kept, row, col, spacing):
    """Directions, as bits, in which a kept apex has a triangle without a void corner."""
    leaves = leaf_directions(kept, row, col, spacing)
    if is_complete or leaves == 0:
        return leaves
    directions = 0
    for direction in range(4):
        if leaves >> direction & 1:
            a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing, direction)
            is_whole = is_valid(heights, a_row, a_col) and is_valid(heights, b_row, b_col)
            directions |= (is_whole and is_valid(heights, row, col)) << direction
    return directions


@jit
def mark_used(heights, kept, words):
    """Mark every vertex that a triangle of the mesh has: next to voids, not all have one."""
    n_rows, n_cols = heights.shape
    for row in range(n_rows):
        for word in range((n_cols + 7) // 8):
            if words[row, word] == 0:
                continue
            for col in range(8 * word, min(8 * word + 8, n_cols)):
                if kept[row, col] == 0:
                    continue
                spacing = spacing_of(row, col)
                directions = present_directions(heights, False, kept, row, col, spacing)
                for direction in range(4):
                    if directions >> direction & 1:
                        a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing, direction)
                        kept[row, col] = kept[a_row, a_col] = kept[b_row, b_col] = USED


@jit
def count_mesh(heights, kept, words, in_mesh, first_row, end_row, n_vertices, n_triangles):
    """Write how many vertices each row has, and how many triangles have their apex there.

    ``in_mesh`` is the byte of the vertices that count: ``KEPT`` where there is no void.
    """
    n_cols = heights.shape[1]
    for row in range(first_row, end_row):
        vertices, triangles = 0, 0
        row_words = words[row]
        for word in range((n_cols + 7) // 8):
            if row_words[word] == 0:
                continue
            for col in range(8 * word, min(8 * word + 8, n_cols)):
                if kept[row, col] != in_mesh:
                    continue
                vertices += 1
                spacing = spacing_of(row, col)
                directions = present_directions(heights, in_mesh == KEPT, kept, row, col, spacing)
                for direction in range(4):
                    triangles += directions >> direction & 1
        n_vertices[row], n_triangles[row] = vertices, triangles


@jit
def fill_vertices(
    heights, kept, words, in_mesh, transform, first_row, end_row, first_vertex, in_word, vertices
):
    """Write x, y and z of the vertices of some rows, in row-major order.

    ``in_word`` gets the number of the first vertex of each eight columns, for ``vertex_number``.
    """
    n_cols = heights.shape[1]
    for row in range(first_row, end_row):
        number = first_vertex[row]
        for word in range((n_cols + 7) // 8):
            if words[row, word] == 0:
                continue
            in_word[row, word] = number
            for col in range(8 * word, min(8 * word + 8, n_cols)):
                if kept[row, col] == in_mesh:
                    vertices[number, 0] = transform[0] * col + transform[1] * row + transform[2]
                    vertices[number, 1] = transform[3] * col + transform[4] * row + transform[5]
                    vertices[number, 2] = heights[row, col]
                    number += 1


@jit
def vertex_number(kept, in_mesh, in_word, row, col):
    """Number of a vertex in the mesh, for an eighth of the memory of one for each sample."""
    number = in_word[row, col >> 3]
    for before in range(col & ~7, col):
        number += kept[row, before] == in_mesh
    return number


@jit
def fill_triangles(
    heights,
    kept,
    words,
    in_mesh,
    swapped,
    first_row,
    end_row,
    first_triangle,
    in_word,
    flip,
    triangles,
):
    """Write the triangles whose apex lies in some rows: hypotenuse first, apex last.

    In place of a triangle (a, b, apex) of a swapped square stands (apex, opposite apex, b).
    """
    n_cols = heights.shape[1]
    for row in range(first_row, end_row):
        number = first_triangle[row]
        for word in range((n_cols + 7) // 8):
            if words[row, word] == 0:
                continue
            apex = in_word[row, word] - 1
            for col in range(8 * word, min(8 * word + 8, n_cols)):
                if kept[row, col] != in_mesh:
                    continue
                spacing = spacing_of(row, col)
                apex += 1
                directions = present_directions(heights, in_mesh == KEPT, kept, row, col, spacing)
                for direction in range(4):
                    if directions >> direction & 1:
                        a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing, direction)
                        a = vertex_number(kept, in_mesh, in_word, a_row, a_col)
                        b = vertex_number(kept, in_mesh, in_word, b_row, b_col)
                        c = apex
                        if is_on_other_diagonal(kept, swapped, row, col, spacing, direction):
                            opposite_row, opposite_col = a_row + b_row - row, a_col + b_col - col
                            a, c = apex, b
                            b = vertex_number(kept, in_mesh, in_word, opposite_row, opposite_col)
                        triangles[number, 0] = b if flip else a
                        triangles[number, 1] = a if flip else b
                        triangles[number, 2] = c
                        number += 1
