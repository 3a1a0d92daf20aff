"""Counters: what the modelled machine did in a frame. This table defines each one, and is all that defines it."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple


class Definition(NamedTuple):
    """One counter. `same_as`: the counter of D3D11, Vulkan or GL with the same meaning, where there is one."""

    stage: str
    unit: str
    text: str
    same_as: str = ""


DEFINITIONS: dict[str, Definition] = {
    "ia_vertices": Definition(
        "input assembler", "control points", "Control points assembled: 16 for each patch; of a subdivision mesh each "
        "vertex that a face has, once, because its patches are indexed.",
        "D3D11 IAVertices, Vulkan INPUT_ASSEMBLY_VERTICES, GL VERTICES_SUBMITTED",
    ),
    "ia_primitives": Definition(
        "input assembler", "patches", "Patches assembled.",
        "D3D11 IAPrimitives, Vulkan INPUT_ASSEMBLY_PRIMITIVES, GL PRIMITIVES_SUBMITTED",
    ),
    "vs_invocations": Definition(
        "vertex shader", "control points", "Vertex-shader runs: one for each control point of a patch, which are not "
        "indexed, and for each vertex of a subdivision mesh, which are; a vertex cache that forgets none.",
        "D3D11 VSInvocations, Vulkan VERTEX_SHADER_INVOCATIONS",
    ),
    "hs_invocations": Definition(
        "hull shader", "patches", "Patches for which the hull shader ran, culled ones included.",
        "D3D11 HSInvocations, Vulkan TESSELLATION_CONTROL_SHADER_PATCHES",
    ),
    "hs_control_points": Definition(
        "hull shader", "control points", "Runs of the control-point phase: 16 for a Bezier patch, 20 for a Gregory patch, 32 "
        "for a patch with tangent patches (16 points and the 16 tangent vectors that do not follow from them).",
    ),
    "hs_culled_nonfinite": Definition("hull shader", "patches", "Patches dropped for a NaN or infinity in their input."),
    "hs_culled_frustum": Definition("hull shader", "patches", "Patches whose bound lies outside a plane of the frustum."),
    "hs_culled_backface": Definition(
        "hull shader", "patches", "Patches of which the face-cull mode would drop all, by a back-patch test."
    ),
    "hs_bounds_evaluated": Definition(
        "hull shader", "bounds", "Bounds evaluated: one for each patch, and one for each sub-domain that owns a triangle."
    ),
    "hs_subpatches": Definition(
        "hull shader", "sub-domains", "Sub-domains that the patches alive are cut into, those culled included (`subpatch` "
        "binning); a patch that is not split is one.",
    ),
    "hs_subpatches_culled_frustum": Definition(
        "hull shader", "sub-domains", "Sub-domains whose bound lies outside a plane of the frustum."
    ),
    "ts_culled_factor": Definition(
        "tessellator", "patches", "Patches that reached the tessellator alive and had an edge factor that is not above 0."
    ),
    "ts_patches": Definition("tessellator", "patches", "Patches left alive after the hull shader and the tessellator's cull."),
    "ts_domain_points": Definition(
        "tessellator", "domain points", "Domain points of the patches alive, each patch once: the least a frame must shade "
        "when no finer cull is known.",
    ),
    "ts_triangles": Definition("tessellator", "triangles", "Triangles of the patches alive, each patch once."),
    "bin_patches": Definition(
        "binning", "patches", "Patches queued in at least one tile; in `subpatch` binning those with such a sub-domain."
    ),
    "bin_patches_offscreen": Definition(
        "binning", "patches", "Patches alive whose screen rectangle touches no pixel, and so are queued nowhere "
        "(`patch` binning).",
    ),
    "bin_subpatches": Definition("binning", "sub-domains", "Sub-domains queued in at least one tile (`subpatch` binning)."),
    "bin_subpatches_offscreen": Definition(
        "binning", "sub-domains", "Sub-domains alive whose screen rectangle touches no pixel, and so are queued nowhere."
    ),
    "bin_patch_tile_pairs": Definition("binning", "pairs", "Pairs of a patch and a tile that it is queued in."),
    "bin_subpatch_tile_pairs": Definition("binning", "pairs", "Pairs of a sub-domain and a tile that it is queued in."),
    "bin_triangle_tile_pairs": Definition("binning", "pairs", "Pairs of a triangle and a tile that it is queued in."),
    "queue_entries": Definition("queues", "entries", "Entries written to all tile queues."),
    "queue_longest": Definition("queues", "entries", "Entries of the longest tile queue."),
    "queue_bytes": Definition(
        "queues", "bytes", "Memory that all queues of the frame take, with the records that their entries refer to "
        "(layout: tiler/queues.py).",
    ),
    "queue_bytes_written": Definition(
        "queue memory", "bytes", "Bytes written to lists by the queue model: entries, links, headers and records; in every "
        "pass again.",
    ),
    "queue_bytes_read": Definition(
        "queue memory", "bytes", "Bytes read from lists by the queue model, without any cache: an entry that is read fetches "
        "its record, and each record that it shares.",
    ),
    "queue_peak_bytes": Definition(
        "queue memory", "bytes", "Most bytes of lists and records in use at a time by the queue model, chunks and blocks whole."
    ),
    "queue_chunks": Definition(
        "queue memory", "chunks", "Chunks given to lists by the queue model, those that lists have from the start included."
    ),
    "queue_wasted_bytes": Definition(
        "queue memory", "bytes", "Bytes of chunks and blocks in which nothing was written when the queues were worked off."
    ),
    "queue_flushes": Definition(
        "queue memory", "flushes", "Times that the pool was full and all tiles worked off what was queued (policy `flush`)."
    ),
    "queue_grows": Definition("queue memory", "doublings", "Times that the pool was full and was doubled (policy `grow`)."),
    "queue_tile_passes": Definition(
        "queue memory", "pairs", "Pairs of a tile and a pass in which its queue has an entry; a pass ends with a flush or the "
        "frame.",
    ),
    "cz_units_tested": Definition(
        "coarse Z", "tests", "Patches or sub-domains tested whole against a pyramid of the picture (`two_phase`, "
        "`previous_frame`); once against each pyramid.",
    ),
    "cz_units_occluded": Definition(
        "coarse Z", "units", "Patches or sub-domains that this frame's pyramid hides as wholes: they are queued nowhere."
    ),
    "cz_stale_rejects": Definition(
        "coarse Z", "units", "Patches or sub-domains hidden in the last frame's pyramid and not in this frame's; drawn in the "
        "second phase.",
    ),
    "cz_pairs_tested": Definition(
        "coarse Z", "tests", "Queue entries tested: the part of a unit's rectangle, or of a triangle's box in `triangle` "
        "binning, that lies in the tile.",
    ),
    "cz_pairs_occluded": Definition("coarse Z", "pairs", "Queue entries found hidden: nothing of them is worked on."),
    "cz_triangles_tested": Definition(
        "coarse Z", "tests", "Triangles of patches and sub-domains tested in a tile, by their box and their nearest vertex."
    ),
    "cz_triangles_occluded": Definition("coarse Z", "pairs", "Triangles so found hidden in a tile: not rasterized there."),
    "cz_blocks_tested": Definition("coarse Z", "tests", "Blocks of triangles' boxes tested in rasterization."),
    "cz_blocks_occluded": Definition("coarse Z", "blocks", "Blocks in which the triangle is hidden, and not rasterized."),
    "cz_blocks_accepted": Definition(
        "coarse Z", "blocks", "Blocks in which the triangle is nearer than all: its depth test need not read the depths."
    ),
    "cz_cells_read": Definition("coarse Z", "cells", "Cells of pyramids read by tests of units, pairs and triangles."),
    "cz_outlines_tested": Definition(
        "coarse Z", "tests", "Cells that do not hide a unit, and are asked whether the outline of its bound reaches them "
        "(`occlusion_area=\"hull\"`).",
    ),
    "cz_outlines_missed": Definition("coarse Z", "cells", "Cells that it does not reach, which therefore hide the unit."),
    "cz_hits_level_0": Definition("coarse Z", "tests", "Units, pairs and triangles found hidden at level 0, the blocks."),
    "cz_hits_level_1": Definition("coarse Z", "tests", "Units, pairs and triangles found hidden at level 1, 2x2 blocks."),
    "cz_hits_level_2": Definition("coarse Z", "tests", "Units, pairs and triangles found hidden at level 2, 4x4 blocks."),
    "cz_hits_level_3_up": Definition("coarse Z", "tests", "Units, pairs and triangles found hidden at level 3 or above."),
    "cz_updates": Definition(
        "coarse Z", "blocks", "Updates by feedback `tile`. `recompute`: for each queue entry the blocks that a triangle's box "
        "touches of which some sample passed. `feed_forward`: each time one triangle lowers a block's farthest depth.",
    ),
    "dc_lookups": Definition("domain cache", "pairs", "Queue entries for which the domain cache was asked for the points."),
    "dc_hits": Definition("domain cache", "pairs", "Queue entries whose points were in the domain cache."),
    "ds_invocations": Definition(
        "domain shader", "domain points", "Domain points shaded. In `patch` and `subpatch` binning without a domain cache "
        "every tile shades a unit again, and sub-domains shade their common points each.",
        "D3D11 DSInvocations, Vulkan TESSELLATION_EVALUATION_SHADER_INVOCATIONS",
    ),
    "c_invocations": Definition(
        "clipper", "triangles", "Triangles that reach the clipper. In `patch` and `subpatch` binning again in every tile.",
        "D3D11 CInvocations, Vulkan CLIPPING_INVOCATIONS, GL CLIPPING_INPUT_PRIMITIVES",
    ),
    "c_primitives": Definition(
        "clipper", "triangles", "Triangles that leave the clipper, before face culling; a cut one counts as its fan.",
        "D3D11 CPrimitives, Vulkan CLIPPING_PRIMITIVES, GL CLIPPING_OUTPUT_PRIMITIVES",
    ),
    "c_culled_outside": Definition("clipper", "triangles", "Triangles of which the clipper leaves nothing."),
    "c_culled_nonfinite": Definition("clipper", "triangles", "Triangles dropped for a NaN or infinity."),
    "c_cut": Definition("clipper", "triangles", "Triangles that were cut and left as a fan."),
    "su_culled_zero_area": Definition("set-up", "triangles", "Triangles without area after the snap to 1/256 pixel."),
    "su_culled_face": Definition("set-up", "triangles", "Triangles culled by the face-cull mode."),
    "su_culled_no_sample": Definition("set-up", "triangles", "Triangles between the sample columns or rows."),
    "su_culled_offscreen": Definition("set-up", "triangles", "Triangles all of whose sample positions are off the picture."),
    "su_culled_outside_tile": Definition(
        "set-up", "triangles", "Triangles set up in a tile of `patch` or `subpatch` binning that do not touch it: other "
        "tiles draw them.",
    ),
    "su_triangles": Definition(
        "set-up", "triangles", "Triangles that passed set-up; in `patch` and `subpatch` binning again in every tile, those "
        "outside it too.",
    ),
    "rs_triangles": Definition("rasterizer", "pairs", "Pairs of a triangle and a tile that the rasterizer walks."),
    "rs_samples_covered": Definition("rasterizer", "samples", "Samples covered by triangles: each is one depth test."),
    "om_samples_passed": Definition("output merger", "samples", "Samples that passed the depth test and were written."),
    "om_samples_failed": Definition("output merger", "samples", "Samples that failed the depth test."),
    "ps_invocations": Definition(
        "pixel shader", "pixels", "Pixels of triangles with at least one covered sample that passed the early depth test, "
        "in queue order.",
        "D3D11 PSInvocations, Vulkan FRAGMENT_SHADER_INVOCATIONS",
    ),
    "ps_helper_invocations": Definition(
        "pixel shader", "pixels", "Pixels that run beside those of `ps_invocations` so that each 2x2 block is whole, for "
        "derivatives; they write nothing. D3D11 leaves open whether PSInvocations has them; here it has not.",
    ),
    "om_spilled_bytes": Definition(
        "output merger", "bytes", "Colour and depth that tiles write at the end of a pass and read again at their next: 8 "
        "bytes a sample each way.",
    ),
    "om_samples_visible": Definition("output merger", "samples", "Samples that hold a triangle at the end of the frame."),
}  # fmt: skip


class Counters(Mapping[str, int]):
    """Counters of a frame by name, in pipeline order; a read-only mapping to int."""

    def __init__(self, values: Mapping[str, int]) -> None:
        missing, extra = DEFINITIONS.keys() - values.keys(), values.keys() - DEFINITIONS.keys()
        if missing or extra:
            raise ValueError(f"counters without a value: {sorted(missing)}; without a definition: {sorted(extra)}")
        self._values = {name: int(values[name]) for name in DEFINITIONS}

    def __getitem__(self, name: str) -> int:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"Counters({self._values!r})"

    def _repr_html_(self) -> str:
        from tiler.notebook import counters_html

        return counters_html(self)

    def table(self) -> str:
        """The counters as aligned text: stage, name, value, unit."""
        stage_width = max(len(d.stage) for d in DEFINITIONS.values())
        name_width = max(map(len, self))
        lines = []
        before = ""
        for name, value in self.items():
            definition = DEFINITIONS[name]
            stage = definition.stage if definition.stage != before else ""
            before = definition.stage
            lines.append(f"{stage:<{stage_width}}  {name:<{name_width}}  {value:>15,}  {definition.unit}")
        return "\n".join(lines)
