"""`tiler export`."""

from pathlib import Path

from tiler.commands.options import JsonPath, Quiet
from tiler.commands.output import write_result
from tiler.options import SceneOptions, Text, open_scene, parse_numbers


def export(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    out: Path = Path("scene.glb"),
    bounds: str | None = None,
    patches: Text = None,
    frame: float = 0,
    threads: int | None = None,
    json: JsonPath = None,
    quiet: Quiet = False,
) -> None:
    """Write the tessellated, displaced patches and the boxes that bound them to a .glb file, for any 3D viewer.

    Examples: `tiler export teapot --factor 8`; `tiler export waves --bounds tpatch,npatch --patches 0..31 --out waves.glb`.

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    out
        The file, ending in .glb.
    bounds
        Bounds to show as translucent boxes, separated by commas; none by default.
    patches
        Which patches: FIRST..LAST, or numbers separated by commas; all by default, at most 4096.
    frame
        Which frame of the scene.
    threads
        Threads of this computer to use; all by default.
    json
        Write what the file holds as JSON to this file; - for standard output and nothing else there.
    quiet
        Say nothing.
    """
    from tiler.glb import check_export, export_glb

    names = [] if bounds is None else [name.strip() for name in bounds.split(",")]
    numbers = None if patches is None else parse_numbers(patches, "patches")
    check_export(out, names)
    opened = open_scene(scene, scene_options or SceneOptions())
    found = export_glb(opened, out, bounds=names, patches=numbers, frame=frame, threads=threads)
    result = {"scene": opened.name, "file": str(out), "frame": frame, "bounds": names} | found._asdict()
    if not write_result(result, json) and not quiet:
        print(
            f"{found.patches:,} patches, {found.vertices:,} vertices, {found.triangles:,} triangles, {found.boxes:,} boxes "
            f"in {out}" + (f"; {len(found.left_out):,} patches left out: no surface" if found.left_out else "")
        )
