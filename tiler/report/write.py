"""`write_report`: a frame, machines side by side, or a study as one HTML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Union

from tiler.comparison import Comparison
from tiler.errors import TilerError
from tiler.files import write_bytes
from tiler.frame import Frame
from tiler.report.collect import collect
from tiler.report.collect_study import collect_study
from tiler.report.command import check_report
from tiler.report.encode import Blobs
from tiler.report.page import make_page
from tiler.scene.model import Scene

if TYPE_CHECKING:
    from tiler.study.results import Study


def write_report(
    shown: Union[Frame, Mapping[str, Frame], Comparison, "Study"],
    file: str | Path,
    *,
    scene: Scene | None = None,
    command: str | None = None,
) -> None:
    """Write an HTML file that shows a frame, frames by name (the first is the baseline), a comparison or a study.

    The file needs nothing beside it and no network. It appears whole or not at all; its folder is made if need be.
    scene : the scene that the frames were drawn from; with it there are per-pixel maps, and the patch under the pointer is
    told: that takes about a frame's time more for each different choice of bounds and culls. command : what makes the same
    again, told in the report.

    Raises TilerError for a file that cannot be written, no frame, and pictures of different sizes.
    """
    from tiler.study.results import Study

    check_report(Path(file))
    blobs = Blobs()
    if isinstance(shown, Study):
        data = collect_study(shown, blobs, command)
    else:
        data = collect(_frames(shown), blobs, scene, command)
    write_bytes(Path(file), make_page(data | {"blobs": blobs.stored}).encode())


def _frames(shown: Frame | Mapping[str, Frame] | Comparison) -> Mapping[str, Frame]:
    if isinstance(shown, Frame):
        return {shown.machine.binning: shown}
    if isinstance(shown, Comparison):
        return shown.frames
    if isinstance(shown, Mapping) and all(isinstance(frame, Frame) for frame in shown.values()):
        return shown
    raise TilerError(f"report: {type(shown).__name__} is not allowed; allowed: frames, a comparison or a study")
