"""The conservativeness oracle: every bound and every cull against the vertices that were really shaded.

A frame that is verified is drawn as always, and then once more without any cull: all patches are shaded by the
production domain shader, in clip space and (through the identity matrix, which changes no bit) in world space. Each
bound is compared with every vertex and with every set-up triangle of its patch; each cull with what is visible in the
picture that culls nothing. What does not hold is a `Violation`, with the patch, (u, v), the algorithm and the margin.

The checks of a bound (`CHECKS`), each a margin that must not be negative:

- the float32 world position lies in the oriented box, axis by axis;
- the float32 clip position lies in the hull of the box's clip corners, widened by `slack`, seen along x, y, z, w and along
  the distances from the planes w + x, w - x, w + y, w - y, w - z (z itself is the near plane's);
- the snapped window position, clamped to the viewport, lies in `rect`; where `rect` is empty no vertex is on the screen;
- the window depth is at least `z_min`;
- where `inside` is set, no vertex is outside a plane of the frustum;
- the unit normal of the base surface lies in the normal cone, where that is known;
- the samples' box of each set-up triangle lies in `rect`, and its vertices' depths are at least `z_min`.

A bound says "unknown" with NaN, an infinite box, the whole viewport, or `cone_cos = -1`; then there is nothing to break.

A back-patch test answers for the smooth or the displaced surface. Where it drops a patch of which a coarse triangle faces
the eye and would be seen, while the surface itself does not, that is a *false cull*: counted apart, and no violation. A
test of `TRIANGLE_SAFE` has no such excuse.
"""

from tiler.verify.bounds import (
    BOX,
    CHECKS,
    CLIP,
    CONE,
    DEPTH,
    INSIDE,
    NUM_CHECKS,
    NUM_FUNCTIONS,
    RECT,
    TRIANGLE_DEPTH,
    TRIANGLE_RECT,
    Margins,
    Shaded,
    measure_margins,
    name_violations,
    reach_planes,
    shade_all,
    uv_of,
)
from tiler.verify.facing import (
    DENSE,
    DENSE_NOISE,
    SURFACE_NOISE,
    facing,
    front_triangles,
    grid_patterns,
    point_patterns,
    sort_back_patch_cull,
    surface_facing,
)
from tiler.verify.frame import check_frame, run_each_cull
from tiler.verify.report import Report, Violation

__all__ = [
    "BOX",
    "CHECKS",
    "CLIP",
    "CONE",
    "DENSE",
    "DENSE_NOISE",
    "DEPTH",
    "INSIDE",
    "NUM_CHECKS",
    "NUM_FUNCTIONS",
    "RECT",
    "SURFACE_NOISE",
    "TRIANGLE_DEPTH",
    "TRIANGLE_RECT",
    "Margins",
    "Report",
    "Shaded",
    "Violation",
    "check_frame",
    "facing",
    "front_triangles",
    "grid_patterns",
    "measure_margins",
    "name_violations",
    "point_patterns",
    "reach_planes",
    "run_each_cull",
    "shade_all",
    "sort_back_patch_cull",
    "surface_facing",
    "uv_of",
]
