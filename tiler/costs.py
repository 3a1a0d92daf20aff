"""What each bounding algorithm costs, in invocations of the domain shader: Munkberg et al. 2010, Table 1.

Run as `python -m tiler.costs`. Three measures, over the same smooth displaced patches:

- *time* of the batched kernels on this machine, one thread, best of many runs;
- *operations*: float additions, subtractions, multiplications, divisions, square roots, roundings to whole numbers, and
  comparisons (min and max of two are one each), of single or double precision alike, one for each number however wide the
  machine's vectors are. Counted exactly and the same on every machine: the sources of `pipeline` are loaded once more with
  every operator rewritten to count when its result is a float, and run by the Python interpreter on a few patches. What the
  compiler shares or moves out of loops is counted as the source says it; operations on constants alone are not counted.
- *compiled*: the same operations, counted in the machine's own code by `compiled_costs`.

A bound's cost has three parts: the box itself, the lookup in the min-max pyramid, and `project_box` (clip-space corners,
screen rectangle, depth), which is the same for all algorithms and no part of the paper's figures. "box" is the first part
alone, against a domain-shader invocation of a patch without a map (position, normal, clip position); "all" is everything,
against one with a map (its bilinear lookups, the normal of the displaced surface as well). Operations are told apart by the
module that makes them (the texture rectangle of a domain counts as box); times of the box are those of its own function
where it has one (`BOXES`), else those of all less those of the two other parts, measured by themselves. Both sides of a
ratio are batched kernels that vectorize: the shader over the points of a patch, the bounds over patches, in float32
(`pipeline/bounds/single.py`) or float64 (`pipeline/bounds/lanes.py`). Times are of the thread, and the runs of all that is
compared take turns: a machine changes its speed between one second and the next. Before each run the control points are read,
as in a frame the vertex shader has just written them; else the caches are as the last stage left them. The shader's points and
the boxes alone are written to memory that is there already.
"""

import ast
import contextlib
import copy
import importlib
import importlib.machinery
import operator
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pipeline import bounds as bounds_module
from pipeline import domain
from pipeline.bounds import cbox, normals, oriented
from pipeline.bounds.lookup import displacement_ranges
from pipeline.bounds.project import Boxes, allocate_boxes, project_boxes
from pipeline.displacement import pack_maps
from pipeline.hull import make_input
from pipeline.types import F64, Address, DomainPoints, FaceCull, HullInput, Patterns, Viewport
from pipeline.vertex import make_patches

PAPER = {  # relative to one domain-shader invocation: instructions, Core i7
    "cbox": (1.5, 1.5),
    "obbtex": (2.7, 2.4),
    "tpatch": (4.5, 4.5),
    "npatch": (11.0, 11.0),
}
LOOKUP_MODULES = ("pipeline.minmax", "pipeline.displacement", "pipeline.domain_lookup", "pipeline.bounds.lookup")
LANES_MODULES = ("pipeline.bounds.lanes", "pipeline.wide")
PROJECT_MODULE = "pipeline.bounds.project"
ARITHMETIC = ("add", "sub", "mul", "div", "sqrt", "round")

Tally = Counter[tuple[str, str]]  # (module, kind of operation) -> how many


# Counting


_OPERATORS: dict[type, tuple[str, Callable[[Any, Any], Any]]] = {
    ast.Add: ("add", operator.add),
    ast.Sub: ("sub", operator.sub),
    ast.Mult: ("mul", operator.mul),
    ast.Div: ("div", operator.truediv),
    ast.Lt: ("compare", operator.lt),
    ast.LtE: ("compare", operator.le),
    ast.Gt: ("compare", operator.gt),
    ast.GtE: ("compare", operator.ge),
    ast.Eq: ("compare", operator.eq),
    ast.NotEq: ("compare", operator.ne),
}
_FUNCTIONS = {"sqrt": "sqrt", "floor": "round", "ceil": "round"}


def _floats(value: Any) -> int:
    """How many floats a value is."""
    if isinstance(value, np.ndarray):
        return value.size if value.dtype.kind == "f" else 0
    return int(isinstance(value, (float, np.floating)))


class _Counting:
    """The functions that rewritten sources of one module call."""

    def __init__(self, module: str, tally: Tally) -> None:
        self.module, self.tally = module, tally

    def operate(self, node: str, a: Any, b: Any) -> Any:
        kind, function = _OPERATORS[getattr(ast, node)]
        if kind == "compare":
            result = function(a, b)
            amount = int(_floats(a) > 0 and _floats(b) > 0)
        else:
            result = function(np.float64(a) if type(a) is float else a, b)  # so that x / 0 is what IEEE says
            amount = _floats(result)
        if amount:
            self.tally[self.module, kind] += amount
        return result

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        result = function(*arguments)
        self.tally[self.module, _FUNCTIONS[name]] += _floats(result)
        return result

    def _extreme(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        result = function(*arguments)
        if len(arguments) > 1 and _floats(result):
            self.tally[self.module, "compare"] += len(arguments) - 1
        return result

    def min(self, *arguments: Any) -> Any:
        return self._extreme(min, arguments)

    def max(self, *arguments: Any) -> Any:
        return self._extreme(max, arguments)


def _is_constant(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp):
        return _is_constant(node.left) and _is_constant(node.right)
    if isinstance(node, ast.UnaryOp):
        return _is_constant(node.operand)
    return isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and node.id.isupper())


class _Rewrite(ast.NodeTransformer):
    """Operators on what is not constant become calls of a `_Counting`."""

    @staticmethod
    def _call(method: str, *arguments: ast.expr) -> ast.Call:
        function = ast.Attribute(ast.Name("_counting", ast.Load()), method, ast.Load())
        return ast.Call(function, list(arguments), [])

    def _operate(self, op: ast.AST, a: ast.expr, b: ast.expr) -> ast.Call:
        return self._call("operate", ast.Constant(type(op).__name__), a, b)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        constant = _is_constant(node)
        self.generic_visit(node)
        return node if constant or type(node.op) not in _OPERATORS else self._operate(node.op, node.left, node.right)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        self.generic_visit(node)
        if type(node.op) not in _OPERATORS:
            return node
        value: Any = copy.deepcopy(node.target)
        value.ctx = ast.Load()
        return ast.Assign([node.target], self._operate(node.op, value, node.value))

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        if any(type(op) not in _OPERATORS for op in node.ops):
            return node
        terms = [node.left, *node.comparators]
        parts: list[ast.expr] = [self._operate(op, terms[k], terms[k + 1]) for k, op in enumerate(node.ops)]
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr in _FUNCTIONS:
            return self._call("call", ast.Constant(node.func.attr), node.func, *node.args)
        if isinstance(node.func, ast.Name) and node.func.id in ("min", "max") and not node.keywords:
            return self._call(node.func.id, *node.args)
        return node


class _CountingLoader(importlib.machinery.SourceFileLoader):
    """Loads a module of `pipeline` so that it counts; its decorators compile nothing."""

    tally: Tally

    def exec_module(self, module: Any) -> None:
        if module.__name__ == "pipeline.jit":
            module.kernel = module.helper = module.inlined = lambda function: function
            return
        tree = ast.parse(self.get_data(self.path), self.path)
        module._counting = _Counting(module.__name__, self.tally)
        exec(compile(ast.fix_missing_locations(_Rewrite().visit(tree)), self.path, "exec"), module.__dict__)
        if module.__name__ in LANES_MODULES:
            module.LANES = 1  # a block of one: no operation is made for a lane that is only filled up


class _CountingFinder:
    """Finds modules of `pipeline` for `_CountingLoader`, where Python would find them."""

    def __init__(self, tally: Tally) -> None:
        self.tally = tally

    def find_spec(self, name: str, path: Any, target: Any = None) -> Any:
        if name.split(".")[0] != "pipeline":
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and spec.origin is not None:
            spec.loader = loader = _CountingLoader(name, spec.origin)
            loader.tally = self.tally
        return spec


_SWAPPING = threading.Lock()


@contextlib.contextmanager
def _counting_pipeline(tally: Tally) -> Iterator[None]:
    """While it lasts, `import pipeline...` gives modules that count into `tally`; afterwards all is as before."""
    with _SWAPPING:
        ours = {name: module for name, module in sys.modules.items() if name.split(".")[0] == "pipeline"}
        finder: Any = _CountingFinder(tally)
        for name in ours:
            del sys.modules[name]
        sys.meta_path.insert(0, finder)
        try:
            yield
        finally:
            sys.meta_path.remove(finder)
            for name in [name for name in sys.modules if name.split(".")[0] == "pipeline"]:
                del sys.modules[name]
            sys.modules.update(ours)


# The patches, and what is done with them


GRID = 16  # domain points along an edge, less one


def sample_patches(n: int, displaced: bool) -> HullInput:
    """n smooth patches in front of a camera, each reading its own part of one map."""
    rng = np.random.default_rng(0)
    i, j = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    cp = np.ones((n, 4, 4, 4), np.float32)
    cp[..., :3] = np.stack([i, j, 0 * i], -1) / 3 + rng.normal(0, 0.05, (n, 4, 4, 3)) + rng.uniform(-4, 4, (n, 1, 1, 3))
    corner = rng.uniform(0, 0.9, (n, 1, 2))
    texcoords = (corner + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) / 10).astype(np.float32)
    texels = rng.uniform(-1, 1, (64, 64)).astype(np.float32)
    matrix = np.array([[1.5, 0, 0, 0], [0, 1.5, 0, 0], [0, 0, -1.01, 8.0], [0, 0, -1, 10]], np.float32)
    map_id = np.full(n, 0 if displaced else -1, np.int32)
    patches = make_patches(cp, texcoords, map_id, np.zeros(n, np.int32))
    maps = pack_maps([(texels, Address.WRAP, 0.1, 0.0)])
    return make_input(patches, maps, matrix, Viewport(0, 0, 1280, 720, 0.0, 1.0))


def shader_call(stage: HullInput) -> tuple[Any, ...]:
    """Arguments of `domain.shade_patches` for a grid of GRID x GRID squares on every patch.

    Column after column: of points in rows the shader shares sums over u, and an invocation would not be counted whole.
    """
    n = len(stage.patches.map_id)
    t = np.arange(GRID + 1, dtype=np.float32) / GRID
    uv = np.ascontiguousarray(np.stack(np.meshgrid(t, t)[::-1], 0).reshape(2, -1), np.float32)
    count = uv.shape[1]
    first = np.arange(n + 1, dtype=np.int64) * count
    patterns = Patterns(
        np.zeros(n, np.int32), uv, np.array([0, count]), np.zeros(0, np.uint16), np.zeros(2, np.int64)
    )  # fmt: skip
    points = DomainPoints(first, np.empty((4, n * count), np.float32), np.empty((3, n * count), np.float32))
    live, scratch = np.arange(n, dtype=np.int32), np.zeros(domain.SCRATCH, np.float32)
    return 0, n, live, stage.patches, patterns, stage.maps, stage.clip_from_world, points, scratch


class Operations(NamedTuple):
    """Operations of one invocation, or of one patch's bound."""

    box: float  # all that is not in the two parts below
    lookup: float  # in the map or its pyramid
    project: float  # clip-space corners, rectangle, depth
    kinds: dict[str, float]  # all of them by kind: add, sub, mul, div, sqrt, round, compare

    @property
    def total(self) -> float:
        """All three parts."""
        return self.box + self.lookup + self.project

    @property
    def arithmetic(self) -> float:
        """All but the comparisons."""
        return sum(self.kinds.get(kind, 0.0) for kind in ARITHMETIC)


def split_operations(tally: Tally, invocations: int) -> Operations:
    """What was tallied, for one of so many invocations."""
    lookup = sum(count for (module, _), count in tally.items() if module in LOOKUP_MODULES)
    project = sum(count for (module, _), count in tally.items() if module == PROJECT_MODULE)
    kinds: Counter[str] = Counter()
    for (_, kind), count in tally.items():
        kinds[kind] += count
    shares = {kind: count / invocations for kind, count in sorted(kinds.items())}
    box = tally.total() - lookup - project
    return Operations(box / invocations, lookup / invocations, project / invocations, shares)


def count_operations(num_patches: int = 4) -> dict[str, Operations]:
    """Operations a patch for each of `BOUNDS`; a point for "domain shader" and "domain shader, map". Takes seconds."""
    displaced, plain = sample_patches(num_patches, True), sample_patches(num_patches, False)
    tally: Tally = Counter()
    counts = {}
    with _counting_pipeline(tally), np.errstate(all="ignore"):
        shader = importlib.import_module("pipeline.domain")
        bounds = importlib.import_module("pipeline.bounds").BOUNDS
        for name, stage in (("domain shader", plain), ("domain shader, map", displaced)):
            one = shader_call(stage)
            tally.clear()
            shader.shade_patches(0, 1, *one[2:])
            counts[name] = split_operations(tally, (GRID + 1) ** 2)
        for name, bound in bounds.items():
            tally.clear()
            bound(displaced)
            counts[name] = split_operations(tally, num_patches)
    return counts


CULL_SAMPLE = 32  # patches: full blocks of lanes of every back-patch test


def count_cull_operations(names: Sequence[str]) -> dict[str, float]:
    """Operations a patch of cull tests, names of `CULL_TESTS`, on smooth patches that all of them look at. Takes seconds."""
    stage = sample_patches(CULL_SAMPLE, False)._replace(eye=np.array([0.3, 0.2, 9.0]), face_cull=int(FaceCull.BACK))
    bounds = bounds_module.BOUNDS["cbox"](stage)
    # The frustum test asks no patch that is known to be inside.
    bounds = bounds._replace(inside=np.zeros_like(bounds.inside))
    tally: Tally = Counter()
    counts = {}
    with _counting_pipeline(tally), np.errstate(all="ignore"):
        tests = importlib.import_module("pipeline.culling").CULL_TESTS
        for name in names:
            tally.clear()
            tests[name](stage, bounds, np.zeros(CULL_SAMPLE, np.uint8))
            counts[name] = tally.total() / CULL_SAMPLE
    return counts


# Timing


def _best_times(
    runs: Mapping[str, tuple[Callable[[], Any], int]], repeats: int, before: Callable[[], Any]
) -> dict[str, float]:
    """Seconds of the fastest run of each over its number of items, after one that compiles; they take turns.

    before : precedes each run, and is not timed: what a run finds in the cache shall not depend on the row above it.
    """
    best = dict.fromkeys(runs, np.inf)
    for run, _ in runs.values():
        run()
    for _ in range(repeats):
        for name, (run, items) in runs.items():
            before()
            begin = time.thread_time()
            run()
            best[name] = min(best[name], (time.thread_time() - begin) / items)
    return best


def _box(kind: int, stage: HullInput, ranges: F64, boxes: Boxes) -> None:
    oriented.put_boxes(stage, kind, ranges, boxes)


BOXES: dict[str, Callable[[HullInput, F64, Boxes], None]] = {
    "cbox": lambda stage, ranges, boxes: cbox.put_boxes(stage, stage.pyramids.whole, True, boxes),
    "max_displacement": lambda stage, ranges, boxes: cbox.put_boxes(stage, ranges, False, boxes),
    "obbtex": partial(_box, oriented.NOTHING),
    "tpatch": partial(_box, normals.TPATCH),
    "tpatch_tight": partial(_box, normals.TPATCH_TIGHT),
    "npatch": partial(_box, normals.NPATCH),
}


def box_name(name: str) -> str:
    """The name under which `measure_times` has the box of a bound alone."""
    return f"{name}, box"


def measure_times(num_patches: int = 2000, repeats: int = 50) -> dict[str, float]:
    """Seconds a patch for each of `BOUNDS`, each box of `BOXES` (`box_name`), "lookup" and "projection"; a point for the
    domain shader without and with map."""
    displaced = sample_patches(num_patches, True)
    few = max(1, num_patches // 100)  # a run short enough that another process seldom comes between
    runs: dict[str, tuple[Callable[[], Any], int]] = {}
    for name, with_map in (("domain shader", False), ("domain shader, map", True)):
        call = shader_call(sample_patches(few, with_map))
        runs[name] = partial(domain.shade_patches, *call), few * (GRID + 1) ** 2
    ranges, some = displacement_ranges(displaced), bounds_module.BOUNDS["cbox"](displaced)
    runs["lookup"] = partial(displacement_ranges, displaced), num_patches
    runs["projection"] = partial(project_boxes, displaced.clip_from_world, displaced.viewport, some), num_patches
    boxes = allocate_boxes(num_patches)
    for name, box in BOXES.items():
        runs[box_name(name)] = partial(box, displaced, ranges, boxes), num_patches
    slow: dict[str, tuple[Callable[[], Any], int]] = {
        name: (partial(bound, displaced), num_patches) for name, bound in bounds_module.BOUNDS.items()
    }
    fast = {name: slow.pop(name) for name in BOXES}
    read = displaced.patches.control_points.sum
    return _best_times(runs | fast, repeats, read) | _best_times(slow, max(1, repeats // 10), read)


# The table


def _row(cells: list[str]) -> str:
    return f"{cells[0]:<20}" + "".join(f"{cell:>10}" for cell in cells[1:])


def cost_table() -> str:
    """The table, as text: one line for each of `BOUNDS`. Measures; takes minutes, as kernels are compiled with counters."""
    from tiler.compiled_costs import available, count_compiled  # which takes its patches from here

    counts, times = count_operations(), measure_times()
    compiled = count_compiled() if available() else {}
    plain, mapped = counts["domain shader"], counts["domain shader, map"]
    plain_time, mapped_time = times["domain shader"], times["domain shader, map"]
    lines = [
        "Cost of bounding a patch, in invocations of the domain shader (Munkberg et al. 2010, Table 1)",
        f"one invocation: {plain_time * 1e9:.1f} ns, {plain.total:.0f} operations; "
        f"with a displacement map {mapped_time * 1e9:.1f} ns, {mapped.total:.0f} operations",
        f"in each 'all': projection {times['projection'] * 1e9:.0f} ns; "
        f"pyramid lookup, where made, {times['lookup'] * 1e9:.0f} ns",
        "",
        _row(["", "box", "box", "box", "all", "all", "all", "ns", "ops", "ops", "compiled", "paper", "paper"]),
        _row(
            [
                "algorithm",
                "time",
                "ops",
                "compiled",
                "time",
                "ops",
                "compiled",
                "all",
                "box",
                "all",
                "all",
                "instr.",
                "CPU",
            ]
        ),
    ]
    if compiled:
        one, other = compiled["domain shader"].total, compiled["domain shader, map"].total
        lines.insert(
            2, f"compiled, one invocation: {one:.0f} operations; with a displacement map {other:.0f} operations"
        )
    for name in bounds_module.BOUNDS:
        count, total_time, counted = counts[name], times[name], compiled.get(name)
        rest = total_time - times["projection"] - (times["lookup"] if count.lookup else 0.0)
        box_time = times.get(box_name(name), rest)
        box = counted.box / compiled["domain shader"].total if counted else None
        all_ = counted.total / compiled["domain shader, map"].total if counted else None
        ratios = (
            box_time / plain_time, count.box / plain.total, box, total_time / mapped_time, count.total / mapped.total, all_,
        )  # fmt: skip
        cells = [name, *("-" if ratio is None else f"{ratio:.1f}" for ratio in ratios), f"{total_time * 1e9:.0f}"]
        cells += [f"{count.box:.0f}", f"{count.total:.0f}", f"{counted.total:.0f}" if counted else "-"]
        lines.append(_row(cells + [f"{x:g}" for x in PAPER.get(name, ())]))
    lines += [
        "",
        "time: this machine, one thread, best of many. ops: float operations of the source, comparisons included; compiled: of",
        "the compiled code, all lanes of its vectors; the two of taylor are not compiled with counters, which takes minutes.",
        "box: the box alone against a shader without a map; all: with pyramid lookup and projection against one with a map.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    print(cost_table())
