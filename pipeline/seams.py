"""Texture seams closed: points on an edge take the displacement of its lowest patch, points at a vertex of the vertex's.

Where two patches have different texture coordinates along their edge, each displaces it by another part of the map, and the
surface cracks. `Patches.seam_edges` and `seam_corners` hold, for patches that touch such an edge, the coordinates of the
owner: the patch of the lowest number that has the edge or vertex. The owner's own lookup on its edge is the blend of
the same two corners (the other two have weight 0), in an order that does not matter, so both sides get the same bits.
"""

import numpy as np

from pipeline.displacement import HALF, ONE, fetch
from pipeline.edge_normals import edge_of
from pipeline.jit import helper


@helper
def write_seam_values(edge_coords, corner_coords, maps, m, u, v, t):
    """Row t: the displacement by map m, by their owners' texture coordinates, of those points (u, v) that lie on edges.

    edge_coords float32[4, 2, 2], corner_coords float32[4, 2] : of the patch. The points inside must come last.
    """
    width, height = np.float32(maps.size[m, 0]), np.float32(maps.size[m, 1])
    scale, bias = maps.scale[m], maps.bias[m]
    n = len(u)
    while n > 0 and edge_of(u[n - 1], v[n - 1]) < 0:
        n -= 1
    for k in range(n):
        edge = edge_of(u[k], v[k])
        if edge >= 4:
            x, y = corner_coords[edge - 4, 0], corner_coords[edge - 4, 1]
        elif edge >= 0:
            ends = edge_coords[edge]
            w1 = v[k] if edge % 2 == 0 else u[k]
            w0 = ONE - w1
            x, y = w0 * ends[0, 0] + w1 * ends[1, 0], w0 * ends[0, 1] + w1 * ends[1, 1]
        else:
            continue
        value, _, _ = fetch(maps, m, x * width - HALF, y * height - HALF)
        t[k] = scale * value + bias
