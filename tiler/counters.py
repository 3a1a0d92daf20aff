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
    "ts_culled_factor": Definition(
        "tessellator", "patches", "Patches that reached the tessellator alive and had an edge factor that is not above 0."
    ),
    "ts_patches": Definition("tessellator", "patches", "Patches left alive after the hull shader and the tessellator's cull."),
    "ts_domain_points": Definition(
        "tessellator", "domain points", "Domain points of the patches alive, each patch once: the least a frame must shade "
        "when no finer cull is known.",
    ),
    "ts_triangles": Definition("tessellator", "triangles", "Triangles of the patches alive, each patch once."),
    "bin_patches": Definition("binning", "patches", "Patches queued in at least one tile (`patch` binning)."),
    "bin_patches_offscreen": Definition(
        "binning", "patches", "Patches alive whose screen rectangle touches no pixel, and so are queued nowhere."
    ),
    "bin_patch_tile_pairs": Definition("binning", "pairs", "Pairs of a patch and a tile that it is queued in."),
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
    "ds_invocations": Definition(
        "domain shader", "domain points", "Domain points shaded. In `patch` binning without a domain cache every tile shades "
        "a patch again.",
        "D3D11 DSInvocations, Vulkan TESSELLATION_EVALUATION_SHADER_INVOCATIONS",
    ),
    "c_invocations": Definition(
        "clipper", "triangles", "Triangles that reach the clipper. In `patch` binning again in every tile.",
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
        "set-up", "triangles", "Triangles set up in a tile of `patch` binning that do not touch it: other tiles draw them."
    ),
    "su_triangles": Definition(
        "set-up", "triangles", "Triangles that passed set-up; in `patch` binning again in every tile, those outside it too."
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
