"""Work of patch and sub-patch binning over what the occlusion tests read, and how stale it is."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tiler.reproduce import style
from tiler.reproduce.beyond.machines import IDEAL, METRICS, UNITS, ideal_measures, machine_of, measures, value_of
from tiler.reproduce.beyond.panels import count_ticks, name_ends
from tiler.reproduce.item import Context, Item, Result, Row, Tolerance
from tiler.scene import load_scene
from tiler.scene.camera import eye_and_target
from tiler.scene.model import CameraKey, CameraPath, Scene
from tiler.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPEEDS = (0, 1, 2, 4, 8, 16, 32)
QUICK_SPEEDS = (0, 1, 8)
SIZE, QUICK_SIZE = (960, 540), (480, 270)
FACTOR = 16
FRAME = 36
MODES = ("patch", "subpatch")
LOOK_BACK = ("previous_frame", "two_phase")  # the others know nothing of another frame: the speed is nothing to them
# Colours that no machine has.
STYLES = {
    "none": (style.GREY, "X"),
    "tile": (style.ORANGE, "P"),
    "previous_frame": (style.SKY, "v"),
    "two_phase": (style.PURPLE, "^"),
}

# Stated before measuring, for the walk as it is (speed 1): hidden patches that are queued nowhere are what looking back is for.
FEWER_BYTES = Tolerance(at_least=2.0)
NOT_MUCH_MORE = Tolerance(at_most=2.0)  # shading of a machine that looks back, over that of `tile`
FEWER = Tolerance(at_least=5.0)  # `tile` against no feedback

TEXT = """
`colonnade`, {size}, factor {factor}, always the same picture: that of frame {frame}. The camera came there at 0 (it
stood still) to {top} times the speed of the walk, which is 1/6 unit a frame; so `previous_frame` and `two_phase`
remember a picture from up to {away:.1f} units away. All else of the machines is on, as in the other figures; `none`
makes no occlusion test. The last frame's drawing is not counted.

`tile` knows nothing until it has drawn something in a tile, so every patch in the view is queued, and hidden ones are
found when the tile works them off. The two that look back hide patches before they are queued: several times fewer
bytes. What they pay is staleness: `previous_frame` draws again what it wrongly believed hidden, `two_phase` draws first
what the last frame saw, and neither tests all that it draws first.

At speed 16 `previous_frame` does better than at 8. The camera has moved by 2.7 units then, and the columns are 3 apart,
so the old picture may fit the new one again; that was not tested apart.
"""


def at_speed(scene: Scene, speed: float) -> Scene:
    """The scene with a camera that comes to its view of `FRAME` at `speed` times the pace of its path; 0: it stands there."""
    path = scene.camera
    if speed == 0:
        keys: tuple[CameraKey, ...] = (CameraKey(0.0, *eye_and_target(path, FRAME)),)
    else:
        keys = tuple(CameraKey(FRAME + (key.frame - FRAME) / speed, key.eye, key.target) for key in path.keys)
    return replace(scene, camera=CameraPath(keys, path.up, path.fov, path.near, path.far))


def _table(context: Context, scene: Scene, speeds: Sequence[int]) -> dict[str, list[Any]]:
    moving = {speed: at_speed(scene, speed) for speed in speeds}
    runs = [(mode, "none", 0) for mode in MODES] + [(mode, "tile", 0) for mode in MODES]
    runs += [(mode, feedback, speed) for mode in MODES for feedback in LOOK_BACK for speed in speeds]
    rows: list[dict[str, Any]] = []
    for k, (mode, feedback, speed) in enumerate(runs):
        blame = (mode, feedback) == ("patch", "tile")
        frame = simulate(
            moving[speed], machine_of(mode, z_feedback=feedback, blame=blame), frame=FRAME, threads=context.threads
        )
        for place in [speed] if feedback in LOOK_BACK else speeds:
            rows.append({"speed": place, "machine": mode, "z_feedback": feedback, **measures(frame)})
            if blame:
                rows.append({"speed": place, "machine": IDEAL, "z_feedback": None, **ideal_measures(frame)[IDEAL]})
        context.update((k + 1) / len(runs))
    return {column: [row[column] for row in rows] for column in rows[0]}


def _rows(table: dict[str, list[Any]], speeds: Sequence[int]) -> list[Row]:
    def value(mode: str, feedback: str, column: str, speed: int = 1) -> float:
        return float(value_of(table, column, machine=mode, z_feedback=feedback, speed=speed))

    rows = []
    fastest = speeds[-1]
    for mode in MODES:
        fewer = value(mode, "none", "ds_invocations") / value(mode, "tile", "ds_invocations")
        rows.append(Row(f"{mode}, none / tile: domain-shader invocations", None, fewer, "times", FEWER))
        for feedback in LOOK_BACK:
            fewer = value(mode, "tile", "queue_bytes") / value(mode, feedback, "queue_bytes")
            rows.append(Row(f"{mode}, tile / {feedback}: queue bytes, speed 1", None, fewer, "times", FEWER_BYTES))
            more = value(mode, feedback, "ds_invocations") / value(mode, "tile", "ds_invocations")
            what = f"{mode}, {feedback} / tile: domain-shader invocations, speed 1"
            rows.append(Row(what, None, more, "times", NOT_MUCH_MORE))
            stale = value(mode, feedback, "ds_invocations", fastest) / value(mode, feedback, "ds_invocations", 0)
            what = f"{mode}, {feedback}: domain-shader invocations, speed {fastest} over standing still"
            rows.append(Row(what, None, stale, "", None))
    return rows


def _draw(table: dict[str, list[Any]], figure: "Figure") -> None:
    figure.set_size_inches(10.5, 6.2)
    panels = figure.subplots(len(MODES), len(METRICS), sharex=True)
    speeds = sorted(set(table["speed"]))
    for mode, row in zip(MODES, panels, strict=True):
        for axes, (metric, title) in zip(row, METRICS.items(), strict=True):
            axes.set_yscale("log")
            axes.set_title(f"{mode}: {title}", loc="left", fontweight="bold")
            axes.set_xticks(range(len(speeds)), [f"{speed:g}" if speed else "still" for speed in speeds])
            axes.minorticks_off()
            style.grid(axes)
            if mode == MODES[-1]:
                axes.set_xlabel("speed of the camera (1: the walk)")
            _lines(table, axes, mode, metric, speeds)
    for k, metric in enumerate(METRICS):  # both panels of a column have the range of both
        limits = [axes.get_ylim() for axes in panels[:, k]]
        low, high = min(low for low, _ in limits), max(high for _, high in limits)
        for mode, axes in zip(MODES, panels[:, k], strict=True):
            axes.set_ylim(min(low, high / 12), high)
            count_ticks(axes)
            name_ends(axes, _ends(table, mode, metric, speeds[-1]), 0.06)


def _of(table: dict[str, list[Any]], mode: str, feedback: str | None, metric: str) -> dict[int, float]:
    """Value by speed."""
    rows = zip(table["speed"], table["machine"], table["z_feedback"], table[metric], strict=True)
    return {speed: y for speed, machine, reads, y in rows if (machine, reads) == (mode, feedback) and y}


def _lines(table: dict[str, list[Any]], axes: "Axes", mode: str, metric: str, speeds: Sequence[int]) -> None:
    for feedback, (color, marker) in STYLES.items():
        values = _of(table, mode, feedback, metric)
        if values:
            axes.plot([speeds.index(s) for s in values], list(values.values()), color=color, marker=marker)
    ideal = _of(table, IDEAL, None, metric)
    if ideal:
        axes.plot([speeds.index(s) for s in ideal], list(ideal.values()), "--", color=style.BLACK, linewidth=1.3)


def _ends(table: dict[str, list[Any]], mode: str, metric: str, last: int) -> list[tuple[float, str, str]]:
    ends = [
        (values[last], feedback, color)
        for feedback, (color, _) in STYLES.items()
        if (values := _of(table, mode, feedback, metric))
    ]
    ideal = _of(table, IDEAL, None, metric)
    return [*ends, (ideal[last], "ideal", style.BLACK)] if ideal else ends


def run(context: Context) -> Result:
    """Both modes with each feedback, coming at each speed."""
    speeds, size = (QUICK_SPEEDS, QUICK_SIZE) if context.quick else (SPEEDS, SIZE)
    table = _table(context, load_scene("colonnade", size=size, factor=FACTOR), speeds)
    units = {
        "speed": "speed of the camera on its way to the frame, in that of the walk; 0: it stands still",
        "z_feedback": "what the occlusion tests read",
        **UNITS,
    }
    text = TEXT.format(size="x".join(map(str, size)), factor=FACTOR, frame=FRAME, top=speeds[-1], away=speeds[-1] / 6)
    return Result(tuple(_rows(table, speeds)), table, units, lambda figure: _draw(table, figure), text)


ITEM = Item("beyond", "figure-feedback", "Work over what the occlusion tests read, and how stale it is", run)
