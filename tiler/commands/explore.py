"""`tiler explore`."""

import os
import sys

from tiler.options import MachineOptions, SceneOptions, make_machine, open_scene


def explore(
    scene: str,
    *,
    scene_options: SceneOptions | None = None,
    machine_options: MachineOptions | None = None,
    port: int = 0,
    browser: bool = True,
    threads: int | None = None,
) -> None:
    """Turn camera and machine in a page of this computer's browser, and look into tiles. Ctrl-C ends it.

    Examples: `tiler explore teapot`; `tiler explore model.obj --size 1920x1080 --bounds tpatch`;
    `tiler explore colonnade --port 8000 --no-browser`.

    Parameters
    ----------
    scene
        A name that `tiler scenes` lists, or the path of a scene file.
    port
        Of the address, on this computer alone; 0 for any that is free.
    browser
        Open the page in the browser; the address is printed in any case.
    threads
        Threads of this computer to use; all by default. The result does not depend on it.
    """
    from tiler.explore.server import Explorer, check_libraries, open_browser

    check_libraries()
    opened = open_scene(scene, scene_options or SceneOptions())
    explorer = Explorer(opened, make_machine(machine_options or MachineOptions()), port, threads)
    try:
        print(f"explorer of {opened.name}: {explorer.url}\nCtrl-C ends it.", flush=True)
        if browser:
            open_browser(explorer.url)
        explorer.run()
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
    finally:
        if not explorer.close():
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)  # a thread that compiles a kernel cannot be asked to end
