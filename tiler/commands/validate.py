"""`tiler validate`."""

import sys
from pathlib import Path
from typing import Any, Literal

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import write_result
from tiler.errors import TilerError
from tiler.options import SceneOptions, open_scene


def validate(
    what: Literal["bounds", "tessellator", "limit", "watertight"],
    scene: str | None = None,
    *,
    factor: str | None = None,
    edge_pixels: float | None = None,
    partitioning: Literal["integer", "pow2", "fractional_odd", "fractional_even"] | None = None,
    displacement: str | None = None,
    frame: float = 0,
    samples: int = 10_000_000,
    seed: int = 0,
    bounds: str | None = None,
    reference: Path | None = None,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Check what must hold: bounds and cull tests against shaded points, the tessellator and the limit surface against
    reference answers, a mesh for cracks.

    Examples: `tiler validate bounds --samples 100000000`; `tiler validate tessellator --reference answers.npz`;
    `tiler validate watertight creature --factor 16 --partitioning fractional_odd`.
    The exit status is 1 if something failed.

    Parameters
    ----------
    what
        bounds: all bounds and cull tests, on the built-in scenes, on random patches and on patches that are moved towards
        violation. tessellator: points and indices of every case in a file, bit for bit. limit: positions and normals of
        subdivision patches against limit positions in a file. watertight: both sides of every edge of a scene, bit for bit.
    scene
        A name that `tiler scenes` lists, or the path of a scene file or model (watertight); without the next three options
        at several factors in every partitioning.
    factor
        Tessellation factor, or six: edges u=0, v=0, u=1, v=1, then inside u, v (watertight).
    edge_pixels
        Wished length of an edge's segments on the screen in pixels, instead of a fixed factor (watertight).
    partitioning
        How factors become segments (watertight).
    displacement
        Displacement map of a model file, as for `tiler render` (watertight).
    frame
        Which frame of the scene (watertight).
    samples
        Shaded points that each bound is checked at, at least (bounds).
    seed
        Of the random patches; the same seed makes the same ones (bounds).
    bounds
        Only these bounds, separated by commas (bounds).
    reference
        An .npz file of reference answers (tessellator, limit).
    threads
        Threads of this computer to use; all by default.
    json
        Write the result as JSON to this file; - for standard output and nothing else there.
    quiet
        No table and no progress.
    """
    from tiler import validation
    from tiler.progress import Progress
    from tiler.validation import count_cases, validate_bounds, validate_limit, validate_tessellator

    if what == "watertight":
        if scene is None:
            raise TilerError(
                "scene: missing; allowed: a name that `tiler scenes` lists, or the path of a scene or model"
            )
        chosen = SceneOptions(
            factor=factor, edge_pixels=edge_pixels, partitioning=partitioning, displacement=displacement
        )
        opened = open_scene(scene, chosen)
        settings = validation.settings_of(opened, any(x is not None for x in (factor, edge_pixels, partitioning)))
        with Progress(f"looking for cracks in {opened.name}", len(settings), quiet) as bar:
            result = validation.validate_watertight(
                opened, settings, number=frame, threads=threads, progress=bar.update
            )
    elif what == "bounds":
        names = None if bounds is None else [name.strip() for name in bounds.split(",")]
        with Progress("validating bounds", samples, quiet) as bar:
            result = validate_bounds(samples, seed=seed, names=names, threads=threads, progress=bar.update)
    elif reference is None:
        raise TilerError("reference: missing; allowed: the path of an .npz file of reference answers")
    elif what == "limit":
        with Progress("validating the limit surface", 1, quiet):
            result = validate_limit(reference)
    else:
        with Progress("validating the tessellator", count_cases(reference), quiet) as bar:
            result = validate_tessellator(reference, bar.update)
    if not write_result(result, json) and not quiet:
        _print(result)
    if result["failed"]:
        sys.exit(1)


def _print(result: dict[str, Any]) -> None:
    """A line an algorithm, or a failed case; and what failed."""
    if result["what"] == "watertight":
        print(
            f"{result['edges']:,} edges of two patches, {result['boundary_edges']:,} of one; {result['seams']:,} seams; open: "
            f"{result['open_seams']:,} seams and {result['open_edges']:,} other edges; widest {result['largest_crack']:.6g} "
            f"({result['largest_relative']:.3g} of the diagonal)"
        )
        if result["level_edges"]:
            print(
                f"{result['level_edges']:,} more edges lie along larger ones, where adaptive refinement changes its level; "
                f"widest gap there {result['largest_level_crack']:.6g}"
            )
    for row in result["details"]:
        if "algorithm" not in row:
            print(row)
            continue
        print(
            f"{row['algorithm']:<26} {row['samples']:>15,} samples  {row['cases']:>11,} cases  {row['failed']:>6,} failed"
        )
        for violation in row["violations"]:
            print(f"    {violation}")
    print(f"{result['what']}: {result['cases']:,} cases, {result['failed']:,} failed")
