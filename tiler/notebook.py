"""How results show themselves in a notebook: pictures and plain tables, every text escaped, no script; and as data frames."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from tiler.errors import TilerError

if TYPE_CHECKING:
    from PIL.Image import Image

    from tiler.comparison import Comparison
    from tiler.counters import Counters
    from tiler.frame import Frame
    from tiler.study.results import Study

MOST_ROWS = 20  # of a study that are shown
WIDEST = 640  # pixels of a picture in a table; the picture of a frame by itself has its own size
FRAME_COUNTERS = ("ds_invocations", "queue_entries", "queue_bytes", "rs_samples_covered", "ps_invocations")


def pandas_for(what: str, otherwise: str) -> Any:
    """The module pandas. Raises TilerError where it is not installed. otherwise : what there is without it."""
    try:
        import pandas
    except ImportError:
        raise TilerError(
            f"{what}: pandas is not installed; allowed: after `pip install pandas`, or {otherwise}"
        ) from None
    return pandas


def png(image: "Image") -> bytes:
    """A picture as PNG."""
    content = io.BytesIO()
    image.save(content, "PNG")
    return content.getvalue()


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], caption: str = "") -> str:
    """An HTML table: numbers to the right, with separators; the first cell of a row names it."""
    top = "".join(f'<th scope="col">{escape(str(name))}</th>' for name in head)
    body = "".join(f"<tr>{''.join(_cell(value, k) for k, value in enumerate(row))}</tr>" for row in rows)
    told = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{told}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: Any, column: int) -> str:
    if column == 0:
        return f'<th scope="row" style="text-align:left">{escape(str(value))}</th>'
    if isinstance(value, int | float) and not isinstance(value, bool):
        text = f"{value:,}" if isinstance(value, int) else f"{value:.6g}"
        return f'<td style="text-align:right">{escape(text)}</td>'
    return f'<td style="text-align:left">{escape("" if value is None else str(value))}</td>'


def picture(image: "Image", alt: str) -> str:
    """A picture inside of the page."""
    data = base64.b64encode(png(image)).decode()
    width = min(image.width, WIDEST)
    return f'<img alt="{escape(alt)}" width="{width}" src="data:image/png;base64,{data}">'


def frame_html(frame: "Frame") -> str:
    """The picture, a few counters, and all of them folded away."""
    height, width = frame.depth.shape
    head = f"frame {frame.number:g} of {frame.scene}, {width}x{height}, {frame.machine.binning} binning"
    few = table(("counter", "value"), [(name, frame.counters[name]) for name in FRAME_COUNTERS])
    every = f"<details><summary>all counters</summary>{counters_html(frame.counters)}</details>"
    return f"<figure>{picture(frame.image(), head)}<figcaption>{escape(head)}</figcaption></figure>{few}{every}"


def counters_html(counters: "Counters") -> str:
    """Name, value, unit and definition of each."""
    from tiler.counters import DEFINITIONS

    rows = [(name, value, DEFINITIONS[name].unit, DEFINITIONS[name].text) for name, value in counters.items()]
    return table(("counter", "value", "unit", "what"), rows)


def comparison_html(comparison: "Comparison") -> str:
    """The first machine's picture, and counters side by side; rows that are 0 everywhere are left out."""
    same = comparison.same_picture()
    first = next(iter(comparison.frames.values()))
    told = "pictures: bit-identical" if all(same.values()) else "pictures: DIFFERENT"
    rows = []
    for name, baseline in first.counters.items():
        values = [frame.counters[name] for frame in comparison.frames.values()]
        if any(values):
            rows.append([name, baseline, *(ratio_text(value, baseline) for value in values[1:])])
    return picture(first.image(), first.scene) + table(("counter", *comparison.frames), rows, told)


def ratio_text(value: int, baseline: int) -> str:
    """A number and its ratio to another."""
    return f"{value:,} (x{value / baseline:.3g})" if baseline else f"{value:,}"


def study_html(study: "Study") -> str:
    """What a study is about and its first rows: axes, a few counters, how each row ended."""
    rows, done, failed = study.tally()
    columns = [*study.axes, *(name for name in FRAME_COUNTERS if name in study.columns), "status"]
    found = study.head(MOST_ROWS, columns)
    more = f"; the first {MOST_ROWS} are shown" if done > MOST_ROWS else ""
    told = f"{study.name}: {done:,} of {rows:,} rows, {failed:,} failed{more}"
    return table(columns, [[row[name] for name in columns] for row in found], told)
