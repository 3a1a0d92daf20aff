"""A study file, or the arguments of `tiler.sweep`, becomes a plan; all that is wrong comes in one error.

[study]          name, seed
[sweep]          axes as lists: scene, view, frame, machine, machine.FIELD, and settings of scenes
[[run]]          instead of [sweep]: a list of small sweeps, whose values may be single ones
[machine.NAME]   fields of a machine
[view.NAME]      a family of cameras
"""

import itertools
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, ValidationError

from tiler.comparison import MACHINES
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.scene import Scene, load_scene
from tiler.scene.problems import Path as KeyPath
from tiler.scene.problems import Problem, did_you_mean, error_of, problems_of, shown
from tiler.scene.strict import NotAllowed, Strict, whole
from tiler.scene.toml_lines import toml_lines
from tiler.study.grid import Axis, Block, Grid
from tiler.study.plan import AXES, Plan
from tiler.study.rows import scene_digest
from tiler.study.settings import apply_settings, check_setting, clashes, plain, setting_names
from tiler.study.views import FRAMES, ViewFile, frame_sequence

SIZE_LIMIT = 16 * 2**20  # bytes of a study file
MOST_COMBINATIONS = 4096  # of machine fields that are tried before the study begins
MOST_COMPARED = 100_000  # rows of [[run]] tables that are searched for repetitions


class StudyTable(Strict):
    """Table [study]."""

    name: str = Field("study", min_length=1, max_length=200, description="a text of 1 to 200 letters")
    seed: int = whole(0, 0, 2**31 - 1, " (of random views)")


class StudyFile(Strict):
    """A whole study file; what the tables of axes say is checked one by one."""

    study: StudyTable = Field(StudyTable(), description="a table with name and seed")
    sweep: dict[str, Any] | None = Field(None, description="a table of axes")
    run: list[dict[str, Any]] = Field([], description="tables [[run]] of axes")
    machine: dict[str, Any] = Field({}, description="tables [machine.NAME] with fields of a machine")
    view: dict[str, Any] = Field({}, description="tables [view.NAME] with the key kind")


class _Given(NamedTuple):
    """An axis as it was written."""

    path: KeyPath
    value: Any


@dataclass
class _Draft:
    """What is known so far of a study, and what is wrong with it."""

    folder: Path
    machines: dict[str, dict[str, Any]]
    views: dict[str, ViewFile]
    found: list[Problem] = field(default_factory=list)
    scenes: dict[str, tuple[Scene, dict[str, str]]] = field(default_factory=dict)

    def wrong(self, path: KeyPath, text: str) -> None:
        self.found.append(Problem(path, text))


def read_study(file: Path) -> Plan:
    """The plan of a study file. Raises TilerError with all that is wrong in it."""
    try:
        if file.stat().st_size > SIZE_LIMIT:
            raise TilerError(f"{file}: is larger than {SIZE_LIMIT} bytes, the most that a study file may have")
        text = file.read_bytes().decode("utf-8-sig")
        data = tomllib.loads(text.replace("\r\n", "\n"))
        lines = toml_lines(text.replace("\r\n", "\n"))
    except OSError as error:
        raise TilerError(f"study: {file} cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise TilerError(f"{file}: is not UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise TilerError(_syntax_error(file, text, str(error))) from None
    except RecursionError:
        raise TilerError(f"{file}: is nested too deeply to be read") from None
    return make_plan(data, text, str(file), file.resolve().parent, lines)


def _syntax_error(file: Path, text: str, message: str) -> str:
    """tomllib's message with its place in front; the likeliest slip of a study file is told what to do about it."""
    rows = text.rstrip("\n").split("\n")
    message = message.replace("(at end of document)", f"(at line {len(rows)}, column {len(rows[-1]) + 1})")
    match = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    told = (
        f"{file}:{match[2]}:{match[3]}: not valid TOML: {match[1]}" if match else f"{file}: not valid TOML: {message}"
    )
    return told + ("; beside machine.FIELD write machine.name for machine" if "'machine'" in message else "")


def make_plan(data: dict[str, Any], text: str, where: str, folder: Path, lines: dict[KeyPath, int]) -> Plan:
    """The plan of a study as plain data. where : of error messages. folder : that scene files are looked up in."""
    try:
        study = StudyFile.model_validate(data)
    except ValidationError as error:
        raise error_of(where, problems_of(error, StudyFile), lines) from None
    draft = _Draft(folder, {"default": {}} | {k: dict(v) for k, v in MACHINES.items()}, {"path": ViewFile(kind="path")})
    for name, fields in study.machine.items():
        if _is_table(draft, fields, ("machine", name)) and _try_machine(draft, fields, ("machine", name)):
            draft.machines[name] = fields
    for name, fields in study.view.items():
        if _is_table(draft, fields, ("view", name)):
            try:
                draft.views[name] = ViewFile.model_validate(fields)
            except ValidationError as error:
                draft.found += problems_of(error, ViewFile, ("view", name))
    if draft.found:  # the axes name these
        raise error_of(where, draft.found, lines)
    blocks: list[tuple[KeyPath, list[Block]]] = []
    if study.sweep is not None and study.run:
        draft.wrong(("run",), "stands beside [sweep]; allowed: one of the two")
    elif study.sweep is not None:
        blocks.append((("sweep",), _blocks(draft, study.sweep, ("sweep",), lists=True)))
    elif study.run:
        blocks += [(("run", k), _blocks(draft, run, ("run", k), lists=False)) for k, run in enumerate(study.run)]
    else:
        draft.wrong((), "has no rows; needed: a table [sweep] of axes, or tables [[run]]")
    if not draft.found:
        _find_repeated(draft, blocks)
    if draft.found:
        raise error_of(where, draft.found, lines)
    grid = Grid(list(itertools.chain.from_iterable(made for _, made in blocks)))
    machines = {
        name: Machine(**draft.machines[name]).model_dump(mode="json")
        for name in dict.fromkeys(n for b in grid.blocks for a in b.axes if a.name == "machine" for n in a.values)
    }
    scenes = {name: described for name, (_, described) in draft.scenes.items()}
    return Plan(study.study.name, study.study.seed, text, grid, scenes, machines, draft.views)


def _is_table(draft: _Draft, value: Any, path: KeyPath) -> bool:
    if not isinstance(value, dict):
        draft.wrong(path, f"{shown(value)} is not allowed; allowed: a table")
    return isinstance(value, dict)


def _blocks(draft: _Draft, table: dict[str, Any], path: KeyPath, lists: bool) -> list[Block]:
    """Blocks of one table of axes; nothing, and a problem more, where something in it is wrong."""
    before = len(draft.found)
    given: dict[str, _Given] = {}
    for name, item in _flatten(table, (), path):
        if name in given:
            draft.wrong(item.path, "is given twice")
        given[name] = item
    axes = {name: _axis(draft, name, item, lists) for name, item in given.items()}
    if "view" in given and "frame" in given:
        draft.wrong(given["frame"].path, "stands beside view; a view has its own frames")
    for first, second in clashes(given):
        draft.wrong(given[second].path, f"stands beside {first}; allowed: one of the two keys")
    if len(draft.found) > before:
        return []
    own = [axis for name, axis in axes.items() if name.startswith("machine.")]
    machine = axes.get("machine", Axis("machine", ["default"]))
    _try_combinations(draft, machine, own, given, path)
    settings = [axis for name, axis in axes.items() if name not in AXES and not name.startswith("machine.")]
    found: list[Block] = []
    for name in axes.get("scene", Axis("scene", ["teapot"])).values:
        scene = _open_scene(draft, name, given["scene"].path if "scene" in given else path)
        if scene is None or not _try_settings(draft, scene, settings, given):
            continue
        for view in axes["view"].values if "view" in axes else ["path"]:
            if "view" in axes:
                frames: Sequence[Any] = draft.views[view].frame_numbers(scene)
            else:
                frames = axes["frame"].values if "frame" in axes else [0]
            found.append(Block(name, view, (*settings, Axis("frame", frames), machine, *own)))
    return found


def _flatten(table: dict[str, Any], names: tuple[str, ...], path: KeyPath) -> Iterator[tuple[str, _Given]]:
    """Axes of a table with their dotted names; `machine.name` is another way to write `machine`."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flatten(value, (*names, key), (*path, key))
        else:
            name = ".".join((*names, key))
            yield "machine" if name == "machine.name" else name, _Given((*path, key), value)


def _axis(draft: _Draft, name: str, given: _Given, lists: bool) -> Axis:
    """The axis with checked values."""
    known = [*AXES, *(f"machine.{each}" for each in Machine.model_fields), *setting_names()]
    if name not in known:
        draft.wrong(given.path, f"unknown axis; allowed: {', '.join(known)}{did_you_mean(name, known)}")
        return Axis(name, [])
    if name == "frame":
        try:
            values = frame_sequence(plain(given.value))
        except NotAllowed:
            draft.wrong(given.path, f"{shown(given.value)} is not allowed; allowed: {FRAMES}")
            return Axis(name, [])
        return _once(draft, name, values, given.path)
    written = plain(given.value)
    values = written if isinstance(written, list) else [written]
    if not values:
        draft.wrong(given.path, "is empty; allowed: at least one value")
    checked = []
    for k, value in enumerate(values):
        place = (*given.path, k) if isinstance(written, list) else given.path
        try:
            checked.append(_value(draft, name, value))
        except TilerError as error:
            hint = ""
            if name == "picture.size" and isinstance(value, int):
                hint = "; a list holds the sizes to go through"
            draft.wrong(place, f"{error}{hint}")
    return _once(draft, name, checked, given.path)


def _once(draft: _Draft, name: str, values: Sequence[Any], path: KeyPath) -> Axis:
    """The axis, if no value stands in it twice."""
    if not isinstance(values, range):
        seen: set[str] = set()
        for value in values:
            if repr(value) in seen:
                draft.wrong(path, f"has {shown(value)} twice; allowed: each value once")
                break
            seen.add(repr(value))
    return Axis(name, values)


def _value(draft: _Draft, name: str, value: Any) -> Any:
    """One value of an axis, checked. Raises TilerError."""
    if name == "view":
        return _known(value, draft.views)
    if name == "machine":
        return _known(value, draft.machines)
    if name == "scene":
        if not isinstance(value, str):
            raise TilerError(f"{shown(value)} is not allowed; allowed: a name, or the path of a scene file")
        return value
    if name == "machine.cull" and isinstance(value, str):
        return [] if value == "none" else [part.strip() for part in re.split(r"[+,]", value)]
    if name.startswith("machine."):
        return value  # tried with the other fields
    return check_setting(name, value)


def _known(value: Any, known: Iterable[str]) -> str:
    names = list(known)
    if value not in names:
        hint = did_you_mean(value, names) if isinstance(value, str) else ""
        raise TilerError(f"{shown(value)} is not allowed; allowed: {', '.join(names)}{hint}")
    return str(value)


def _try_machine(draft: _Draft, fields: dict[str, Any], path: KeyPath, given: dict[str, _Given] | None = None) -> bool:
    """Whether a machine can be made; each of its faults is told at its own key."""
    try:
        Machine(**fields)
        return True
    except TilerError as error:
        for line in str(error).splitlines():
            name, _, text = line.partition(": ")
            place = (*path, name.removeprefix("machine."))
            if given and name in given:
                place = given[name].path
            draft.wrong(place, text or line)
        return False


def _try_combinations(draft: _Draft, machine: Axis, own: list[Axis], given: dict[str, _Given], path: KeyPath) -> None:
    """Make every machine of a table once, or each value once where there are too many combinations."""
    if not own:
        return
    names = [axis.name.removeprefix("machine.") for axis in own]
    bases = [draft.machines[name] for name in machine.values]
    if len(bases) * math.prod(len(axis.values) for axis in own) <= MOST_COMBINATIONS:
        combinations = itertools.product(*(axis.values for axis in own))
        tried = [base | dict(zip(names, values, strict=True)) for values in combinations for base in bases]
    else:
        tried = [bases[0] | {name: value} for name, axis in zip(names, own, strict=True) for value in axis.values]
    for fields in tried:
        if not _try_machine(draft, fields, path, given):
            return


def _open_scene(draft: _Draft, name: str, path: KeyPath) -> Scene | None:
    """The scene, loaded once for all tables."""
    if name not in draft.scenes:
        is_file = bool(Path(name).suffix) or len(Path(name).parts) > 1
        source = str((draft.folder / name).absolute()) if is_file else name
        try:
            scene = load_scene(Path(source) if is_file else source)
        except TilerError as error:
            draft.wrong(path, str(error).removeprefix("scene: ").replace("\n", "; "))
            return None
        draft.scenes[name] = (scene, {"source": source, "digest": scene_digest(scene)})
    return draft.scenes[name][0]


def _try_settings(draft: _Draft, scene: Scene, settings: list[Axis], given: dict[str, _Given]) -> bool:
    """Whether the scene has what is to be set."""
    try:
        apply_settings(scene, {axis.name: axis.values[0] for axis in settings})
        return True
    except TilerError as error:
        key, _, text = str(error).partition(": ")
        named = next((n for n in given if n == key or n.startswith(f"{key}.")), None)
        draft.wrong(given[named].path if named else ("sweep",), text)
        return False


def _find_repeated(draft: _Draft, tables: list[tuple[KeyPath, list[Block]]]) -> None:
    """Problems for [[run]] tables with a row that another has too."""
    if len(tables) < 2 or sum(block.size for _, blocks in tables for block in blocks) > MOST_COMPARED:
        return
    seen: dict[str, KeyPath] = {}
    for path, blocks in tables:
        for block in blocks:
            for k in range(block.size):
                row = repr(sorted(block.values(k).items()))
                if seen.setdefault(row, path) != path:
                    draft.wrong(path, f"has a row that run[{seen[row][1]}] has too; allowed: each row once")
                    return
