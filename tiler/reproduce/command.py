"""What `tiler reproduce` does: choose items, run them, tell published beside measured."""

import os
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tiler.errors import TilerError, unknown_name
from tiler.files import make_folder, write_bytes
from tiler.host import available_threads
from tiler.progress import Progress
from tiler.reproduce import page
from tiler.reproduce.catalog import PAPERS, item_names, load_item
from tiler.reproduce.item import Context, failures, row_ok
from tiler.reproduce.models import check_models
from tiler.reproduce.run import Done, run_item, standing, write_index
from tiler.reproduce.style import check_matplotlib
from tiler.reproduce.write import replace_block, rows_of

ALL = "all"


class ReproduceRequest(NamedTuple):
    """The command's arguments."""

    paper: str | None
    table: str | None
    figure: str | None
    item: str | None
    models: Path | None
    out: Path
    page: Path | None
    quick: bool
    again: bool
    seed: int
    threads: int | None
    quiet: bool


def list_items(request: ReproduceRequest) -> dict[str, Any]:
    """Papers with their items; all of them without a paper."""
    papers = _papers(request.paper or ALL)
    found = [
        {"paper": paper, "title": PAPERS[paper],
         "items": [{"item": name, "title": load_item(paper, name).title} for name in item_names(paper)]}
        for paper in papers
    ]  # fmt: skip
    lines = []
    for paper in found:
        lines.append(f"{paper['paper']}: {paper['title']}")
        lines += [f"    {item['item']:<12} {item['title']}" for item in paper["items"]]  # type: ignore[index]
    return {"papers": found, "text": "\n".join(lines)}


def run_command(request: ReproduceRequest, tell: Callable[[str], None]) -> dict[str, Any]:
    """Run the items that are asked for; the result for `--json`. tell : called with the text of each as it stands."""
    chosen = _chosen(request)
    _check(request)
    done: list[Done] = []
    for k, (paper, name) in enumerate(chosen):
        with _progress(f"{paper} {name} ({k + 1} of {len(chosen)})", request.quiet) as update:
            threads = request.threads or available_threads()
            context = Context(request.models, request.quick, threads, request.seed, update)
            done.append(
                run_item(load_item(paper, name), context, request.out / paper, _command(request), request.again)
            )
        write_index(paper, request.out)
        tell(item_text(done[-1], request.out))
    if request.page is not None:
        for paper in dict.fromkeys(paper for paper, _ in chosen):
            tell_on_page(request.page, paper, request.out)
    return _summary(request, done)


def tell_on_page(path: Path, paper: str, out: Path) -> None:
    """Put what stands of a paper between its marks of a page: rows, and figures, which are copied into `img` beside it."""
    records = standing(paper, out)
    parts = [page.digest([(record, rows_of(record)) for record in records])]
    for record in records:
        picture = f"{record['item']}.png"
        if picture in record["files"]:
            copy = f"img/{paper}-{picture}"
            make_folder(path.parent / "img")
            write_bytes(path.parent / copy, (out / paper / picture).read_bytes())
            parts.append(f"![{record['title']}]({copy})\n\n*{record['item']}: {record['title']}*")
    replace_block(path, paper, "\n\n".join(parts))


def item_text(done: Done, out: Path) -> str:
    """An item's rows as text, and where its page is."""
    record, rows = done.record, rows_of(done.record)
    width = max((len(row.what) for row in rows), default=0)
    lines = [f"{record['paper']} {record['item']}: {record['title']}"]
    for row in rows:
        numbers = f"{page.say_number(row.published) or '-':>9} {page.say_number(row.measured):>9} {row.unit}"
        said = {True: "holds", False: "FAILS", None: ""}[row_ok(row)]
        lines.append(f"  {row.what:<{width}} {numbers:<40} {page.say_tolerance(row.tolerance):<24} {said}".rstrip())
    how = "stood already" if done.reused else f"{record['seconds']:.1f} s"
    return "\n".join([*lines, f"  {page.verdict(rows)}; {how}; {out / record['paper'] / record['item']}.md"])


def _summary(request: ReproduceRequest, done: list[Done]) -> dict[str, Any]:
    """`item` is null where several ran; each row names its own."""
    rows = [
        {"item": d.record["item"], "paper": d.record["paper"]} | row | {"ok": row_ok(checked)}
        for d in done
        for row, checked in zip(d.record["rows"], rows_of(d.record), strict=True)
    ]
    items = [
        {"paper": d.record["paper"], "item": d.record["item"], "seconds": d.record["seconds"], "reused": d.reused,
         "files": [str(request.out / d.record["paper"] / file) for file in d.record["files"]]}
        for d in done
    ]  # fmt: skip
    return {
        "paper": request.paper, "item": done[0].record["item"] if len(done) == 1 else None, "rows": rows,
        "items": items, "failed": sum(failures(rows_of(d.record)) for d in done),
    }  # fmt: skip


def _papers(paper: str) -> list[str]:
    if paper == ALL:
        return list(PAPERS)
    if paper not in PAPERS:
        raise TilerError(f"paper: {paper!r} is unknown; {unknown_name(paper, [*PAPERS, ALL])}")
    return [paper]


def _chosen(request: ReproduceRequest) -> list[tuple[str, str]]:
    """(paper, item) of all that is asked for. Raises TilerError for what is not known."""
    if request.paper is None:
        raise TilerError(f"paper: missing; allowed: {', '.join([*PAPERS, ALL])}")
    asked = [(kind, value) for kind, value in zip(("table", "figure", "item"), request[1:4], strict=True) if value]
    papers = _papers(request.paper)
    if not asked:
        return [(paper, name) for paper in papers for name in item_names(paper)]
    if len(asked) > 1:
        raise TilerError(f"{asked[1][0]}: stands beside --{asked[0][0]}; allowed: one of --table, --figure, --item")
    if request.paper == ALL:
        raise TilerError(f"{asked[0][0]}: stands beside all papers; allowed: beside one of {', '.join(PAPERS)}")
    kind, value = asked[0]
    name = value if kind == "item" else f"{kind}-{value}"
    names = item_names(papers[0])
    if name not in names:
        prefix = "" if kind == "item" else f"{kind}-"
        known = [other.removeprefix(prefix) for other in names if other.startswith(prefix)]
        raise TilerError(f"{kind}: {value!r} is unknown in {papers[0]}; {unknown_name(value, known)}")
    return [(papers[0], name)]


def _check(request: ReproduceRequest) -> None:
    """Raise TilerError for what would stop an item after minutes."""
    if request.threads is not None and not 1 <= request.threads <= 1024:
        raise TilerError(f"threads: {request.threads} is not allowed; allowed: 1 to 1024")
    if request.seed < 0:
        raise TilerError(f"seed: {request.seed} is not allowed; allowed: 0 or more")
    check_matplotlib()
    check_models(request.models)
    folder = request.out
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise TilerError(f"out: {request.out} is not allowed; allowed: a folder that can be written")
    if request.page is not None and not request.page.is_file():
        raise TilerError(
            f"page: {request.page} is not allowed; allowed: a page that is there, with marks for its tables"
        )


def _command(request: ReproduceRequest) -> str:
    """The command that makes the same again; folders are left out of it, as they say nothing of the numbers."""
    parts = ["tiler", "reproduce", str(request.paper)]
    for option, value in (("--table", request.table), ("--figure", request.figure), ("--item", request.item)):
        parts += [option, value] if value else []
    parts += ["--models", "DIR"] if request.models is not None else []
    parts += ["--quick"] if request.quick else []
    parts += ["--seed", str(request.seed)] if request.seed else []
    return shlex.join(parts)


@contextmanager
def _progress(what: str, quiet: bool) -> Iterator[Callable[[float], None]]:
    """A bar from 0 to 1."""
    with Progress(what, 1, quiet) as bar:
        yield bar.update
