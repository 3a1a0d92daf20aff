"""Silhouette-aware tessellation factors: finer where a patch shows its outline (Loop, Niessner, Eisenacher 2011, outlook).

A patch that is neither wholly front-facing nor wholly back-facing may hold a silhouette, and that is where the facets of a
coarse tessellation are seen. Its factors are raised; an edge that it shares is raised on both sides, so nothing cracks.
"""

import numpy as np

from pipeline.types import B1, F32, I32, U8, TessFactors


def shared_edges(control_points: F32) -> I32:
    """A number for each edge, int32[P, 4] in the order of SV_TessFactor; edges that are shared have the same number.

    control_points : float32[P, 4, 4, 4]. Edges are shared where their four control points are equal bit for bit, in
    either direction. The numbers depend on the shape only, so they can be kept while a mesh is animated.
    """
    return edges_and_directions(control_points)[0]


def edges_and_directions(control_points: F32) -> tuple[I32, B1]:
    """`shared_edges`, and for each edge whether its number runs against u or v, bool[P, 4]."""
    n = len(control_points)
    edges = np.stack(
        [control_points[:, 0], control_points[:, :, 0], control_points[:, 3], control_points[:, :, 3]], axis=1
    ).reshape(4 * n, 4, 4)
    bits = np.ascontiguousarray(edges + np.float32(0.0)).view(np.uint32).reshape(4 * n, 16)  # + 0 makes -0 a +0
    turned = bits.reshape(4 * n, 4, 4)[:, ::-1].reshape(4 * n, 16)
    # Of both directions take the one that comes first in lexicographic order.
    differs = bits != turned
    first = np.where(differs.any(axis=1), differs.argmax(axis=1), 0)
    rows = np.arange(4 * n)
    against = turned[rows, first] < bits[rows, first]
    bits = np.where(against[:, None], turned, bits)
    _, number = np.unique(bits, axis=0, return_inverse=True)
    return number.reshape(n, 4).astype(np.int32), against.reshape(n, 4)


def raise_factors(factors: TessFactors, edge: I32, silhouette: U8, scale: float, most: float) -> TessFactors:
    """Factors times `scale`, at most `most`, on the edges and inside of patches marked in `silhouette` (uint8[P]).

    edge : `shared_edges`. An edge gets the greatest factor that one of its patches wants, on all sides; inside factors of
    patches that are not marked stay. `most` does not lower a factor that was above it.
    """
    marked = silhouette.astype(bool)
    wanted = factors.edge.copy()
    wanted[marked] = np.maximum(wanted[marked], np.minimum(wanted[marked] * np.float32(scale), np.float32(most)))
    greatest = np.zeros(edge.max(initial=-1) + 1, np.float32)
    np.maximum.at(greatest, edge, wanted)
    inside = factors.inside.copy()
    raised = np.minimum(inside[marked] * np.float32(scale), np.float32(most))
    inside[marked] = np.maximum(inside[marked], raised)
    return TessFactors(greatest[edge], inside)
