"""Walks over longest edges."""

import numpy as np

from rtin._kernels._jit import jit


@jit
def walk_over(twins, start, side, stamp, seen):
    """Walk from a side of a triangle as refining it would: triangles met, and those met first now.

    Ends at the boundary, after two triangles that share their longest edge, at ``start``, or where
    the walk has been before, as it may if side 0 is not the longest. ``seen`` holds for each
    triangle the latest walk that met it; the walks from one start have the numbers stamp - side on.
    """
    length, fresh = 0, 0
    half_edge = twins[3 * start + side]
    while half_edge >= 0:
        triangle = half_edge // 3
        if triangle == start or seen[triangle] == stamp:
            break
        if seen[triangle] < stamp - side:
            fresh += 1
        seen[triangle] = stamp
        length += 1
        if half_edge % 3 == 0:
            break
        half_edge = twins[3 * triangle]
    return length, fresh


@jit
def fill_propagation(twins, chosen, m1, m2):
    """Write M1 and M2 of the chosen triangles."""
    seen = np.full(twins.size // 3, -1, np.int64)
    for i in range(chosen.size):
        for side in range(3):
            length, fresh = walk_over(twins, chosen[i], side, 3 * i + side, seen)
            m1[i] += fresh
            m2[i] = max(m2[i], length)
