"""The contract between the stages: every array that one stage writes and another reads.

All are flat NamedTuples of arrays, struct-of-arrays, first axis = item; kernels read them as they are. Naming of sizes:
P patches, N domain points, T triangles, K distinct tessellation patterns, L displacement maps.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
B1 = NDArray[np.bool_]


class Address(IntEnum):
    """Texture address modes (D3D11_TEXTURE_ADDRESS_MODE, the three that a displacement map needs)."""

    WRAP = 0
    MIRROR = 1
    CLAMP = 2


class FaceCull(IntEnum):
    """D3D11_CULL_MODE; a front face is clockwise on the screen (FrontCounterClockwise = FALSE)."""

    NONE = 0
    FRONT = 1
    BACK = 2


class Partitioning(IntEnum):
    """D3D11_TESSELLATOR_PARTITIONING, and ANY where a stage is not told which: then what it says holds for all."""

    ANY = 0
    INTEGER = 1
    POW2 = 2
    FRACTIONAL_ODD = 3
    FRACTIONAL_EVEN = 4


class CullFlag(IntEnum):
    """Why the hull stage dropped a patch: the value of `cull_flags`; 0 is alive. The first reason found counts."""

    ALIVE = 0
    NONFINITE = 1
    FACTOR = 2
    FRUSTUM = 3
    BACKFACE = 4


class DisplacementMaps(NamedTuple):
    """All displacement maps of a scene, packed. A displacement is `scale * bilinear(texels) + bias`, world units.

    A map of vectors is four rows: its own, one texel of zero that stands for it, and behind the rows of all maps one for each
    component, maps like any other. Its displacement is `turn @ (components)`, with each component's scale and bias.
    """

    texels: F32  # (sum of w*h,) row-major, row 0 at t = 0
    first: I64  # (L+1,) texels of map k are texels[first[k]:first[k+1]]
    size: I32  # (L, 2) width, height in texels
    address: I32  # (L,) Address
    scale: F32  # (L,)
    bias: F32  # (L,)
    planes: I32  # (L, 3) rows of the components of a map of vectors; -1 for any other row
    turn: F32  # (L, 3, 3) of a map of vectors: from its axes to the world's, column vectors


class Pyramids(NamedTuple):
    """Min-max pyramids of all maps, packed. Level k of map m is size[m, k] texels and starts at first[m, k]; 0 is the map."""

    lo: F32  # least texel of each block
    hi: F32  # greatest texel of each block
    first: I64  # (L, levels)
    size: I64  # (L, levels, 2) width, height; 0 beyond the top level, which is 1 x 1
    whole: (
        F64  # (L, 2) range of any lookup anywhere, world units; of vectors +- their length: `displacement.map_ranges`
    )


class Slopes(NamedTuple):
    """Min-max pyramids of the differences of neighbouring texels of all maps, before scale: `pipeline.slopes`."""

    along_s: Pyramids
    along_t: Pyramids


class Patches(NamedTuple):
    """Bicubic patches as the hull stage's control-point phase leaves them, world space.

    Three kinds. Bezier (both ids -1): the normal is that of the derivatives. ACC (`tangent_id`): positions as Bezier, the
    normal is that of two tangent patches of bi-degree (2, 3) and (3, 2). Gregory (`gregory_id`): each inner control point
    is a quotient of two given points, which depends on (u, v); `control_points` holds their mean there.

    Patches of one surface may share normals on their edges (`normal_id`): points there use those of the edge, and of the
    vertex at a corner, so both sides get the same bits. They differ from the patch's own by `normal_slack` where the patch is
    displaced along them; else nothing but shading depends on them, and it is 0.
    """

    control_points: F32  # (P, 4, 4, 4) homogeneous (wx, wy, wz, w), [p, i, j]: i along u, j along v
    rational: U8  # (P,) 1 where some control point has w != 1
    texcoords: F32  # (P, 4, 2) (s, t) at (u, v) = (0,0) (1,0) (0,1) (1,1)
    map_id: I32  # (P,) displacement map, -1 = not displaced
    object_id: I32  # (P,) the object that the patch belongs to
    tangent_id: I32  # (P,) row of the patch in tangent_u and tangent_v, -1 = its tangents are its derivatives
    gregory_id: I32  # (P,) row of the patch in inner, -1 = it is a Bezier patch
    tangent_u: F32  # (A, 3, 4, 3) control vectors of bi-degree (2, 3), [a, i, j]: i along u, j along v
    tangent_v: F32  # (A, 4, 3, 3) control vectors of bi-degree (3, 2)
    inner: F32  # (G, 4, 2, 3) f+ and f- of the corners (u, v) = (0,0) (1,0) (1,1) (0,1)
    normal_id: I32  # (P,) row of the patch in edge_row and corner_row, -1 = its edges have its own normals
    edge_row: I32  # (M, 4) rows of edge_normals, SV_TessFactor order; ~row where the edge runs against u or v
    corner_row: I32  # (M, 4) rows of corner_normals at (u, v) = (0,0) (1,0) (0,1) (1,1)
    edge_normals: F32  # (E, 6, 3) control vectors of degree 5 of the edge's normal, not unit
    corner_normals: F32  # (V, 3) unit
    normal_slack: F32  # (P,) at most this far is the unit normal on an edge from that of the patch's own tangents
    seam_id: (
        I32  # (P,) row of the patch in seam_edges and seam_corners, -1 = its edges are displaced by its own texcoords
    )
    seam_edges: (
        F32  # (S, 4, 2, 2) (s, t) with which edges are displaced: SV_TessFactor order, low and high end of u or v
    )
    seam_corners: F32  # (S, 4, 2) (s, t) with which corners are displaced: (u, v) = (0,0) (1,0) (0,1) (1,1)

    def take(self, rows: I32 | I64 | slice) -> "Patches":
        """The patches of these numbers, in this order; the tables of tangents and inner points stay whole."""
        return self._replace(
            control_points=self.control_points[rows],
            rational=self.rational[rows],
            texcoords=self.texcoords[rows],
            map_id=self.map_id[rows],
            object_id=self.object_id[rows],
            tangent_id=self.tangent_id[rows],
            gregory_id=self.gregory_id[rows],
            normal_id=self.normal_id[rows],
            normal_slack=self.normal_slack[rows],
            seam_id=self.seam_id[rows],
        )


class TessFactors(NamedTuple):
    """Output of the hull stage's patch-constant phase, input of the tessellator (SV_TessFactor order)."""

    edge: F32  # (P, 4) edges u=0, v=0, u=1, v=1
    inside: F32  # (P, 2) along u, along v


class HullInput(NamedTuple):
    """What the hull stage's bounds and cull tests may look at. Made by `hull.make_input`; kernels get its parts."""

    patches: Patches  # world space
    maps: DisplacementMaps
    pyramids: Pyramids
    slopes: Slopes | None  # made by who needs them where they are not given
    clip_from_world: F32  # (4, 4)
    eye: F64  # (3,) world space; NaN where there is none, and then nothing is back-facing
    viewport: "Viewport"
    domain: F64  # (P, 4) u0, u1, v0, v1: the part of each patch that is bounded; (0, 1, 0, 1) is all of it
    factors: TessFactors
    face_cull: int  # FaceCull: which triangles the rasterizer drops
    partitioning: int  # Partitioning: how the factors will be rounded


class PatchBounds(NamedTuple):
    """What a bounding algorithm says of each displaced patch: an oriented box, and what follows from it on screen."""

    center: F64  # (P, 3) world space
    axes: F64  # (P, 3, 3) half-extent vectors (rows): the box is center +- axes[0] +- axes[1] +- axes[2]
    corners: F64  # (P, 8, 4) box corners in clip space, exact images up to float64 rounding
    slack: F64  # (P, 4) how far x, y, z, w of the float32 shader's clip position may leave the corners' hull
    rect: I32  # (P, 4) pixels x0 y0 x1 y1, ends exclusive, clipped to the picture; x0 == x1: touches no pixel
    z_min: F32  # (P,) no sample of the patch has a smaller depth; 0 where nothing is known
    inside: U8  # (P,) 1: wholly inside the frustum, no triangle of it needs the clipper
    cone_axis: F64  # (P, 3) normal cone; zero where unknown
    cone_cos: F64  # (P,) cosine of its half angle; -1 = unknown


class Patterns(NamedTuple):
    """The distinct tessellation patterns of a frame. Patch p uses pattern `of_patch[p]` (-1: culled by a factor)."""

    of_patch: I32  # (P,)
    uv: F32  # (2, sum of points): row 0 all u, row 1 all v
    first_point: I64  # (K+1,)
    indices: U16  # (3 * sum of triangles,) point numbers local to the pattern
    first_triangle: I64  # (K+1,) in triangles


class DomainPoints(NamedTuple):
    """Domain-shader output: points of live patch number k (k-th in submit order) are first[k]:first[k+1]."""

    first: I64  # (live+1,)
    clip: F32  # (4, N) x, y, z, w in clip space, row per component
    normal: F32  # (3, N) unit, world space; zero where the surface has none


class Viewport(NamedTuple):
    """D3D11_VIEWPORT with integer bounds; scalars, so that kernels take it whole."""

    left: int
    top: int
    width: int
    height: int
    min_depth: float
    max_depth: float


class Window(NamedTuple):
    """Vertices after viewport and snap: domain points first, then vertices that the clipper made."""

    x: I32  # (V,) 16.8 fixed point, right
    y: I32  # (V,) 16.8 fixed point, down
    z: F32  # (V,) window depth
    w: F32  # (V,) clip-space w
    code: U8  # (V,) OutCode bits; meaningful for domain points only


class Triangles(NamedTuple):
    """Triangles that survived set-up, clockwise. Those of live patch k lie at first[k] .. first[k] + used[k] - 1."""

    first: I64  # (live+1,) room for every triangle that the patch may give
    used: I32  # (live,)
    vertex: I32  # (T, 3) into Window; the first is the leading vertex
    box: NDArray[np.int16]  # (T, 4) first column, first row, last column, last row with a sample, inclusive
    cover: U16  # (T,) of a box of at most 4x4 pixels: bit 4 * row + column, its centre is covered; 65535: not known
    edges: (
        U8  # (T,) bit i: the edge opposite vertex i is the tessellation's, not a cut of the clipper; bit 3: back face
    )
    patch: I32  # (T,) patch number
    source: I32  # (T,) number within its pattern of the tessellated triangle that it is, or was cut from
