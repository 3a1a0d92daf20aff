"""What `tiler bench` prints and writes: the same tables as text, as a page, and as JSON."""

from collections.abc import Mapping
from typing import Any

from tiler.bench.run import Results
from tiler.bench.scaling import Point, triangle_fit
from tiler.bench.startup import ASKED
from tiler.bench.tables import Table, aligned, markdown

ASKED_DOMAIN_NS = 25.0
ASKED_OF_LIMIT = 3.0
ASKED_BYTES = 4e9
ASKED_RATIO = {"triangle": 5.0, "culling": 12.0}
ASKED_VIEW_SECONDS = 60.0

INTRODUCTION = """# Where the time goes

Made by `tiler bench --peer llvmpipe --startup --million --page docs/performance.md`. Seconds are of one computer at one
moment, and no test holds the page to them. What is counted, not timed, is in [the counters](counters.md).

The scene is a displaced torus of bicubic patches, closed and seen whole (`tiler/bench/scenes.py`). The machine is `triangle`
binning without cull tests, except where a row names another. Its frames are drawn by regions, patch by patch
(`tiler/regions.py`); so the rows of stages are of frames that are drawn stage by stage, as other machines' frames are. Stages
are timed from outside, around the calls of `render_frame`; bounds and cull tests by calls of their own. Other scenes beside the
peer are given with `--scene`: rows that say `monsterfrog` are of a scene file with that model, 1,292 faces, displaced by its
own map, which is not ours to ship. Its patches share normals along edges; the peer's shader has none of that.
"""


def as_json(results: Results) -> dict[str, Any]:
    """The result as plain data."""
    found: dict[str, Any] = {
        "host": results.host,
        "stages": [stage._asdict() for stage in results.stages],
        "peer": results.peer,
    }
    if results.limits is not None:
        found["limits"] = results.limits._asdict()
    if results.scaling:
        fit = triangle_fit(results.scaling)
        found["scaling"] = [point._asdict() for point in results.scaling]
        found["fit"] = None if fit is None else fit._asdict()
    if results.memory is not None:
        found["memory"] = results.memory._asdict()
    if results.views is not None:
        found["views"] = results.views._asdict() | {"whole_seconds": results.views.whole_seconds}
    if results.startup:
        found["startup"] = [wait._asdict() for wait in results.startup]
    return found


def as_text(results: Results) -> str:
    """The result for a terminal."""
    return "\n\n".join(aligned(table) for table in tables(results))


def as_page(results: Results) -> str:
    """The result as a page of the documentation."""
    return "\n".join([INTRODUCTION, *(markdown(table) for table in tables(results))])


def tables(results: Results) -> list[Table]:
    """All tables that the results have rows for, the asked figures first."""
    made = [
        _host(results.host),
        _asked(results),
        _stages(results),
        _views(results),
        *_scaling(results.scaling),
        _peer(results),
    ]
    return [table for table in made if table.rows]


def _host(host: Mapping[str, Any]) -> Table:
    rows = [[key, str(value)] for key, value in host.items() if not isinstance(value, dict)]
    rows += [[name, version] for name, version in host["versions"].items()]
    return Table("Measured on", ["", ""], rows, words=2)


def _asked(results: Results) -> Table:
    """Figure, measured, asked, reached."""
    rows: list[tuple[str, float, str, float, bool]] = []  # what, measured, format, asked, whether more is better
    stages = {(s.stage, s.threads): s.ns for s in results.stages}
    for (name, threads), ns in stages.items():
        if name.startswith("domain shader") and threads == 1:
            rows.append((f"{name}: ns an invocation, one thread", ns, ".1f", ASKED_DOMAIN_NS, False))
            if results.limits is not None:
                part = ns / results.limits.domain_ns
                rows.append((f"{name}: times the arithmetic limit", part, ".1f", ASKED_OF_LIMIT, False))
    if results.views is not None:
        v = results.views
        what = f"{v.asked:,} views of {v.patches:,} patches through {', '.join(v.culled)}, one thread: s"
        rows.append((what, v.whole_seconds, ".1f", ASKED_VIEW_SECONDS, False))
    for row in results.peer:
        if row["machine"] in ASKED_RATIO:
            what = f"{row['scene']}, factor {row['factor']:g}, {row['machine']}: times faster than llvmpipe"
            rows.append((what, row["ratio"], ".1f", ASKED_RATIO[row["machine"]], True))
    if results.memory is not None:
        m = results.memory
        what = f"{m.patches:,} patches, factor {m.factor:g}, {m.size[0]}x{m.size[1]}: peak GB"
        rows.append((what, m.peak_bytes / 1e9, ".2f", ASKED_BYTES / 1e9, False))
    for wait in results.startup:
        what = f"{wait.what}: s ({wait.cpu_seconds:.1f} s of processors)"
        rows.append((what, wait.seconds, ".2f", ASKED[wait.what], False))
    return Table(
        "Asked and reached",
        ["", "measured", "asked", ""],
        [
            [
                what,
                f"{value:{form}}",
                f"{'>=' if more else '<='} {asked:g}",
                "yes" if (value >= asked) == more else "no",
            ]
            for what, value, form, asked, more in rows
        ],
    )


def _stages(results: Results) -> Table:
    limits = results.limits
    rows = []
    for stage in results.stages:
        limit = ""
        if limits is not None and stage.stage.startswith("domain shader"):
            limit = f"{limits.domain_ns / stage.ns / stage.threads:.0%}"
        elif limits is not None and stage.stage.startswith("clear"):
            limit = f"{limits.clear_ns / stage.ns / stage.threads:.0%}"
        rows.append([stage.stage, stage.per, str(stage.threads), _number(stage.ns), limit])
    note = ""
    if limits is not None:
        note = (
            f"Limits of one thread: {limits.operations / 1e9:.1f} G float32 operations a second (multiplies and adds, "
            f"never fused), {limits.bandwidth / 1e9:.1f} GB/s copied. A domain-shader invocation with its map is "
            f"{limits.domain_operations:.0f} operations of the source, {limits.domain_ns:.1f} ns at that limit; "
            f"a cleared pixel is {limits.clear_bytes} bytes."
        )
    return Table("Stages", ["stage", "per", "threads", "ns", "of limit"], rows, words=2, note=note)


def _views(results: Results) -> Table:
    v = results.views
    if v is None:
        return Table("Many views", [], [])
    rows = [[name, f"{n:,}", f"{100 * n / (v.patches * v.views):.1f}"] for name, n in v.culled.items()]
    note = (
        f"{v.views:,} of {v.asked:,} views measured, in {v.seconds:.2f} s of one thread's processor time: "
        f"{v.seconds / (v.views * v.patches) * 1e9:.1f} ns a patch and view for all three tests. "
        "Patches of a torus without displacement, eyes even over a sphere of 1.2 bounding radii."
    )
    return Table("Many views", ["test", "patches culled, all views", "%"], rows, note=note)


def _scaling(points: list[Point]) -> list[Table]:
    made = []
    for axis in dict.fromkeys(point.axis for point in points):
        rows = [
            [f"{p.value:,}", f"{p.patches:,}", f"{p.factor:g}", f"{p.size[0]}x{p.size[1]}", str(p.threads), f"{p.triangles:,}",
             f"{p.seconds * 1e3:,.1f}", f"{p.cpu_seconds * 1e3:,.1f}", f"{p.seconds / p.triangles * 1e9:,.1f}",
             f"{p.spin * 1e3:.2f}"]
            for p in points if p.axis == axis
        ]  # fmt: skip
        note = ""
        if axis == "factor" and (fit := triangle_fit(points)) is not None:
            note = (
                f"Least squares: {fit.offset * 1e3:.1f} ms + {fit.slope * 1e9:.1f} ns a triangle, r^2 = {fit.r2:.4f}."
            )
        head = [
            axis,
            "patches",
            "factor",
            "picture",
            "threads",
            "triangles",
            "ms",
            "CPU ms",
            "ns a triangle",
            "spin ms",
        ]
        made.append(Table(f"Frame time over {axis}", head, rows, words=0, note=note))
    return made


def _peer(results: Results) -> Table:
    rows = [
        [r["scene"], r["machine"], f"{r['factor']:g}", f"{r['seconds'] * 1e3:,.0f}", f"{r['peer_seconds'] * 1e3:,.0f}",
         f"{r['ratio']:.2f}", f"{r['peer_fastest'] / r['fastest']:.2f}", f"{r['cpu_ratio']:.2f}",
         f"{r['spin'] * 1e3:.2f}", f"{r['ds_invocations']:,}", f"{r['peer_ds_invocations']:,}",
         f"{r['covered_by_one']:,} of {r['covered']:,}", f"{r['depth_most']:.1e}"]
        for r in results.peer
    ]  # fmt: skip
    note = (
        f"{results.peer_name}. Medians of frames drawn in turn; ratio: llvmpipe's time to ours; fastest: the same of "
        "the fastest frames; CPU ratio: the same of processor time, all threads."
    )
    head = ["scene", "machine", "factor", "ms", "llvmpipe ms", "ratio", "fastest", "CPU ratio", "spin ms", "DSInvocations",
            "llvmpipe's", "pixels of one only", "depth apart"]  # fmt: skip
    return Table("Side by side with llvmpipe", head, rows, words=2, note=note)


def _number(ns: float) -> str:
    return f"{ns:,.0f}" if ns >= 1000 else f"{ns:.3g}"
