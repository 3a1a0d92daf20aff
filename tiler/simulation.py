"""`simulate`: the public door to the machine. Checks what comes in; the machine trusts."""

import math
from collections.abc import Callable
from numbers import Real

from tiler.config import Machine
from tiler.errors import TilerError
from tiler.frame import Frame
from tiler.history import Reel
from tiler.host import Host, available_threads
from tiler.machine import render_frame
from tiler.memory import check_picture
from tiler.scene.model import Scene
from tiler.shared import Shared


def simulate(
    scene: Scene,
    machine: Machine | None = None,
    *,
    frame: float = 0,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    reel: Reel | None = None,
    shared: Shared | None = None,
) -> Frame:
    """Draw one frame of a scene on a machine, and count what the machine does.

    scene : what `tiler.load_scene` gives. machine : `tiler.Machine()` by default. frame : place on the camera path, in
    frames. threads : host threads, all by default; they change the time taken and nothing else. progress : called with
    the part that is done, 0 to 1, after each batch of patches; an exception that it raises ends the simulation. reel :
    one `tiler.history.Reel` for all frames of a run, drawn one after the other: a machine that looks back at the last frame
    takes it from there, and draws it anew only where it was not drawn. shared : a `tiler.Shared` that frames of one scene on
    several machines are given, one after the other: stages that a change of machine does not touch are not run again. With
    either the frame is the same, bit for bit.

    Raises TilerError if an argument is not allowed or the picture does not fit into memory.
    """
    machine = Machine() if machine is None else machine
    threads = available_threads() if threads is None else threads
    check_request(scene, machine, threads, frame)
    with Host(threads) as host:
        report = progress or (lambda part: None)
        if shared is None:
            return render_frame(scene, machine, frame, host, report, reel)
        shared.begin()
        return render_frame(scene, machine, frame, host, report, reel, shared)


def check_request(scene: Scene, machine: Machine, threads: int, frame: float = 0) -> None:
    """Raise TilerError if a frame cannot be simulated so; nothing large is allocated."""
    if not isinstance(scene, Scene):
        raise TilerError(f"scene: {scene!r} is not allowed; allowed: a Scene, as tiler.load_scene returns it")
    if not isinstance(machine, Machine):
        raise TilerError(f"machine: {machine!r} is not allowed; allowed: a tiler.Machine")
    if not isinstance(threads, int) or not 1 <= threads <= 1024:
        raise TilerError(f"threads: {threads!r} is not allowed; allowed: 1 to 1024")
    if not isinstance(frame, Real) or not math.isfinite(frame):
        raise TilerError(f"frame: {frame!r} is not allowed; allowed: a finite number")
    check_picture(scene.picture, machine, threads)
