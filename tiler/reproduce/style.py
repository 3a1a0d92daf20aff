"""How the figures look: one colour and marker an algorithm, the same in all of them; files that are the same every time.

The colours are those of Okabe and Ito, which people who see no red or no green tell apart; a marker each says it again.
"""

import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLACK, GREY, LIGHT = "#000000", "#7f7f7f", "#bdbdbd"
ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"

# Algorithm, cull test, or machine: its colour and its marker.
STYLES: dict[str, tuple[str, str]] = {
    "cbox": (VERMILION, "s"),
    "max_displacement": (ORANGE, "P"),
    "obbtex": (BLUE, "D"),
    "tpatch": (GREEN, "o"),
    "tpatch_tight": (SKY, "v"),
    "npatch": (PURPLE, "^"),
    "taylor": (BLACK, "x"),
    "taylor_clamped": (GREY, "*"),
    "none": (BLACK, "x"),
    "ncone": (BLUE, "D"),
    "tcone": (VERMILION, "s"),
    "tangent_plane": (GREEN, "o"),
    "normal_box": (PURPLE, "^"),
    "displaced": (SKY, "v"),
    "tessellation_safe": (ORANGE, "P"),
    "frustum": (BLUE, "D"),
    "frustum:world": (GREEN, "o"),
    "frustum:object": (ORANGE, "P"),
    "triangle": (VERMILION, "s"),
    "patch": (BLUE, "D"),
    "subpatch": (GREEN, "o"),
    "ideal": (BLACK, "x"),
}

SETTINGS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "figure.constrained_layout.use": True,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "tiler",  # identifiers in the file do not change from run to run
}
DPI = 150


def color_of(name: str) -> str:
    """Colour of an algorithm, cull test or machine; `backface:` before its name is left out."""
    return STYLES[name.removeprefix("backface:")][0]


def marker_of(name: str) -> str:
    """Marker of an algorithm, cull test or machine."""
    return STYLES[name.removeprefix("backface:")][1]


def line_style(name: str) -> dict[str, Any]:
    """Arguments of `Axes.plot` for the line of an algorithm, cull test or machine, its label included."""
    return {"color": color_of(name), "marker": marker_of(name), "label": name.removeprefix("backface:")}


def grid(axes: "Axes", axis: str = "y") -> None:
    """Faint lines behind the data. axis : "x", "y" or "both"."""
    axes.grid(True, axis=axis)  # type: ignore[arg-type]


def check_matplotlib() -> None:
    """Raise TilerError where figures cannot be drawn."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise TilerError(
            "reproduce: matplotlib is not installed; allowed: after `pip install 'tilesim[plot]'`"
        ) from None


def figure_files(draw: Callable[["Figure"], None]) -> tuple[bytes, bytes]:
    """A figure as PNG and as SVG; the same bytes for the same data and version of Matplotlib."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(SETTINGS):
        figure = Figure(figsize=(7.0, 4.2))
        draw(figure)
        png, svg = io.BytesIO(), io.BytesIO()
        figure.savefig(png, format="png", dpi=DPI, metadata={"Software": None})
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return png.getvalue(), svg.getvalue()
