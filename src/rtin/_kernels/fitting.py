"""Arithmetic of fitting heights: sums over the samples of each triangle, and what they ask for."""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.criteria import first_and_end_col, first_and_end_row

MARGIN = 0.999  # of the tolerance, aimed at: what is asked for is met before the aim is
NO_WEIGHT = 1e-9  # what rounding may leave of 0


@jit
def weight_slopes(places, a, b, c):
    """Per row and per column: how fast the weight of a grows, then that of b; NaN on a flat line.

    The plane through three vertices has the height wa za + wb zb + (1 - wa - wb) zc.
    """
    a_row, a_col = places[a, 0] - places[c, 0], places[a, 1] - places[c, 1]
    b_row, b_col = places[b, 0] - places[c, 0], places[b, 1] - places[c, 1]
    determinant = a_row * b_col - b_row * a_col
    if determinant == 0.0:
        return np.nan, np.nan, np.nan, np.nan
    return b_col / determinant, -b_row / determinant, -a_col / determinant, a_row / determinant


# --- which triangle a sample belongs to ---------------------------------------------------------


@jit
def fill_owners(places, triangles, members, first_row, owners):
    """Write the triangle of each sample of some rows that has one: on a shared edge, the last."""
    end_row, n_cols = first_row + owners.shape[0], owners.shape[1]
    for triangle in members:
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        if np.isnan(weight_slopes(places, a, b, c)[0]):
            continue
        start, stop = first_and_end_row(places, a, b, c, first_row, end_row)
        for row in range(start, stop):
            left, right = first_and_end_col(places, a, b, c, row, n_cols)
            owners[row - first_row, left:right] = triangle


@jit
def count_samples(owners, heights, starts):
    """Write where the samples of each triangle start in a list of all that have a height."""
    starts[:] = 0
    for row in range(owners.shape[0]):
        for col in range(owners.shape[1]):
            if owners[row, col] >= 0 and not np.isnan(heights[row, col]):
                starts[owners[row, col] + 1] += 1
    for triangle in range(starts.size - 1):
        starts[triangle + 1] += starts[triangle]


@jit
def list_samples(owners, heights, starts, samples):
    """Write that list: numbers of samples, triangle by triangle, in row-major order in each."""
    ends = starts[:-1].copy()
    for row in range(owners.shape[0]):
        for col in range(owners.shape[1]):
            triangle = owners[row, col]
            if triangle >= 0 and not np.isnan(heights[row, col]):
                samples[ends[triangle]] = row * owners.shape[1] + col
                ends[triangle] += 1


# --- what the samples ask for -------------------------------------------------------------------


@jit
def beyond(value, limit):
    """How far a value is outside of -limit to limit, with its sign."""
    if value > limit:
        return value - limit
    if value < -limit:
        return value + limit
    return 0.0


@jit
def pressed(error, allowed, stiffness):
    """Weight of a sample, and its weighted error: what is beyond the tolerance counts for more."""
    excess = beyond(error, MARGIN * allowed)
    if stiffness == 0.0 or excess == 0.0:
        return 1.0, error
    return 1.0 + stiffness, error + stiffness * excess


@jit
def allowed_at(tolerance, row, col):
    """The tolerance of a sample: ``tolerance`` has one row and column for all, or the raster's."""
    return tolerance[0, 0] if tolerance.size == 1 else tolerance[row, col]


@jit
def sum_samples(
    places, z, triangles, first, end, starts, samples, heights, tolerance, stiffness, sums
):
    """Write the sums of some triangles; return the sum of squared errors, and how many are too far.

    Minimised is, over all samples, error² + stiffness · (what of it is beyond the tolerance)². Its
    second derivatives by the heights of a triangle's corners, halved, are columns 0 to 5 of
    ``sums``: aa, ab, ac, bb, bc, cc. The first ones, halved, are columns 6 to 8.
    """
    n_cols = heights.shape[1]
    total, n_beyond = 0.0, 0
    for triangle in range(first, end):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        a_by_row, a_by_col, b_by_row, b_by_col = weight_slopes(places, a, b, c)
        aa = ab = ac = bb = bc = cc = of_a = of_b = of_c = 0.0
        for k in range(starts[triangle], starts[triangle + 1]):
            row = samples[k] // n_cols
            col = samples[k] - row * n_cols
            down, right = row - places[c, 0], col - places[c, 1]
            wa = a_by_row * down + a_by_col * right
            wb = b_by_row * down + b_by_col * right
            wc = 1.0 - wa - wb
            error = z[c] + wa * (z[a] - z[c]) + wb * (z[b] - z[c]) - heights[row, col]
            total += error * error
            allowed = allowed_at(tolerance, row, col)
            n_beyond += abs(error) > allowed
            weight, error = pressed(error, allowed, stiffness)
            aa += weight * wa * wa
            ab += weight * wa * wb
            ac += weight * wa * wc
            bb += weight * wb * wb
            bc += weight * wb * wc
            cc += weight * wc * wc
            of_a += wa * error
            of_b += wb * error
            of_c += wc * error
        sums[triangle, :3] = aa, ab, ac
        sums[triangle, 3:6] = bb, bc, cc
        sums[triangle, 6:] = of_a, of_b, of_c
    return total, n_beyond


@jit
def pin_exact(places, triangles, starts, samples, n_cols, tolerance, free):
    """Unmark the vertices that have a weight at a sample without any tolerance."""
    for triangle in range(triangles.shape[0]):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        a_by_row, a_by_col, b_by_row, b_by_col = weight_slopes(places, a, b, c)
        for k in range(starts[triangle], starts[triangle + 1]):
            row = samples[k] // n_cols
            col = samples[k] - row * n_cols
            if allowed_at(tolerance, row, col) > 0.0:
                continue
            down, right = row - places[c, 0], col - places[c, 1]
            wa = a_by_row * down + a_by_col * right
            wb = b_by_row * down + b_by_col * right
            free[a] &= abs(wa) <= NO_WEIGHT
            free[b] &= abs(wb) <= NO_WEIGHT
            free[c] &= abs(1.0 - wa - wb) <= NO_WEIGHT


# --- conjugate gradients ------------------------------------------------------------------------


@jit
def gather(triangles, sums, diagonal, pull):
    """Add up what the triangles around each vertex say: its second derivative, and minus its first.

    Both are zero before.
    """
    for triangle in range(triangles.shape[0]):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        diagonal[a] += sums[triangle, 0]
        diagonal[b] += sums[triangle, 3]
        diagonal[c] += sums[triangle, 5]
        pull[a] -= sums[triangle, 6]
        pull[b] -= sums[triangle, 7]
        pull[c] -= sums[triangle, 8]


@jit
def multiply(triangles, sums, vector, product):
    """Write the matrix of second derivatives times a vector, triangle by triangle."""
    product[:] = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        at_a, at_b, at_c = vector[a], vector[b], vector[c]
        product[a] += sums[t, 0] * at_a + sums[t, 1] * at_b + sums[t, 2] * at_c
        product[b] += sums[t, 1] * at_a + sums[t, 3] * at_b + sums[t, 4] * at_c
        product[c] += sums[t, 2] * at_a + sums[t, 4] * at_b + sums[t, 5] * at_c


@jit
def dot(one, other):
    """Sum of products, in a fixed order."""
    total = 0.0
    for i in range(one.size):
        total += one[i] * other[i]
    return total


@jit
def step_down(triangles, sums, free, goal, most_rounds, z):
    """Move the free vertices to the least value of the quadratic function that the sums describe.

    Conjugate gradients with the diagonal as preconditioner, until its norm of the residual has
    fallen to ``goal`` of what it was. What no sample sees stays: moves start from zero.
    """
    scale, residual, product = np.zeros(z.size), np.zeros(z.size), np.empty(z.size)
    gather(triangles, sums, scale, residual)
    for vertex in range(z.size):
        scale[vertex] = 1.0 / scale[vertex] if free[vertex] else 0.0
    direction = scale * residual
    norm = dot(residual, direction)
    enough = goal * goal * norm
    for _ in range(most_rounds):
        if not norm > enough:
            return
        multiply(triangles, sums, direction, product)
        curvature = dot(direction, product)
        if not curvature > 0.0:
            return
        length, before, norm = norm / curvature, norm, 0.0
        for vertex in range(z.size):
            z[vertex] += length * direction[vertex]
            residual[vertex] -= length * product[vertex]
            norm += residual[vertex] * scale[vertex] * residual[vertex]
        for vertex in range(z.size):
            direction[vertex] = scale[vertex] * residual[vertex] + norm / before * direction[vertex]
