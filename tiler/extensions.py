"""Bounds and cull tests of users, beside the built-in ones.

Registered by a call (`tiler.register_bound`, `tiler.register_cull_test`) or, for installed packages, by an entry point of the
group `tilesim.plugins`: a module that makes those calls when it is imported. The command line, and the processes that it
starts, also import what `TILER_PLUGINS` names: modules or .py files, separated by commas; `tiler --plugin` adds to it.
What is registered is in `BOUNDS`, `CULL_TESTS` and the tables beside them, so whatever loops over these has it:
`compare`, `validate bounds`, `bench`, reports, studies.
"""

import importlib
import os
import re
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from pipeline.bounds import BOUNDS, Bound
from pipeline.culling import CLASSIFIERS, CULL_TESTS, FLAG_OF, TRIANGLE_SAFE, CullTest
from pipeline.types import CullFlag
from tiler.errors import TilerError

GROUP = "tilesim.plugins"
VARIABLE = "TILER_PLUGINS"
KINDS = {"frustum": CullFlag.FRUSTUM, "backface": CullFlag.BACKFACE}
NAME = re.compile(r"[a-z][a-z0-9_]*")

_origins: dict[str, str] = {}  # name of a registered bound or test -> module it came from
_loaded: set[str] = set()


def register_bound(name: str, bound: Bound | None = None, *, box: Callable[..., Any] | None = None) -> None:
    """Make a bound known by `name`, in `Machine(bounds=name)` and everywhere else.

    box : a function of one patch (pipeline/bounds/user.py); roundings of the shader are added to what it says.
    bound : instead, one of all patches, `bound(stage: HullInput) -> PatchBounds`, as the built-in ones are.
    Registering a name of one's own again replaces it. Raises TilerError for a name that is built in or is no identifier of
    lower-case letters, digits and _, for none or both functions, and for one that does not compile.
    """
    _check_name("bound", name, name, BOUNDS)
    function = _only_one("bound", name, {"bound": bound, "box": box})
    if box is not None:
        from pipeline.bounds.user import make_bound

        bound = _compiled("bound", name, "box", make_bound, box)
    assert bound is not None
    BOUNDS[name] = bound
    _origins[name] = getattr(function, "__module__", None) or "?"


def register_cull_test(
    name: str,
    cull: CullTest | None = None,
    *,
    facing: Callable[..., Any] | None = None,
    triangle_safe: bool = False,
) -> None:
    """Make a cull test known by `name`, which is `frustum:NAME` or `backface:NAME` for what its culls are counted as.

    facing : a function of one undisplaced patch and the eye (pipeline/culling/user.py); of `backface:` tests.
    cull : instead, one of all patches, `cull(stage, bounds, flags)`, as the built-in ones are.
    triangle_safe : it answers for every triangle of the tessellation, not for the smooth patch: a front-facing triangle that
    it drops is then a violation, not a false cull. Errors as of `register_bound`.
    """
    kind, _, rest = name.partition(":")
    if kind not in KINDS:
        raise TilerError(f"cull test: {name!r} is not allowed; allowed: frustum:NAME or backface:NAME")
    _check_name("cull test", name, rest, CULL_TESTS)
    function = _only_one("cull test", name, {"cull": cull, "facing": facing})
    if facing is not None:
        if kind != "backface":
            raise TilerError(f"cull test: {name!r} has a facing; allowed: of backface:NAME")
        from pipeline.culling.user import make_classifier, make_cull_test

        CLASSIFIERS[name] = _compiled("cull test", name, "facing", make_classifier, facing)
        cull = make_cull_test(CLASSIFIERS[name])
    else:
        CLASSIFIERS.pop(name, None)
    assert cull is not None
    CULL_TESTS[name] = cull
    FLAG_OF[name] = KINDS[kind]
    (TRIANGLE_SAFE.add if triangle_safe else TRIANGLE_SAFE.discard)(name)
    _origins[name] = getattr(function, "__module__", None) or "?"


def unregister(name: str) -> None:
    """Forget a registered bound or cull test. Raises TilerError for a name that is not registered."""
    if name not in _origins:
        raise TilerError(f"name: {name!r} is not registered; allowed: {', '.join(_origins) or 'none is'}")
    tables: tuple[dict[str, Any], ...] = (BOUNDS, CULL_TESTS, FLAG_OF, CLASSIFIERS, _origins)
    for table in tables:
        table.pop(name, None)
    TRIANGLE_SAFE.discard(name)


def registered() -> dict[str, str]:
    """What is registered, and the module that each came from."""
    return dict(_origins)


def load_plugins() -> None:
    """Import installed plug-ins and those of TILER_PLUGINS, each once. Raises TilerError for one that cannot be imported."""
    for entry in entry_points(group=GROUP):
        if entry.value not in _loaded:
            _import(entry.value, f"plug-in {entry.name!r}", entry.load)
    for name in filter(None, (part.strip() for part in os.environ.get(VARIABLE, "").split(","))):
        if name not in _loaded:
            _import(name, f"plug-in {name!r}", partial(_import_named, name))


def _import(key: str, what: str, load: Callable[[], Any]) -> None:
    try:
        load()
    except TilerError:
        raise
    except Exception as error:
        raise TilerError(f"{what}: cannot be imported: {type(error).__name__}: {error}") from error
    _loaded.add(key)


def _import_named(name: str) -> None:
    if not name.endswith(".py"):
        importlib.import_module(name)
        return
    path = Path(name)
    if not path.is_file():
        raise TilerError(f"plug-in: {name!r} is not there; allowed: the path of a .py file, or a module's name")
    module_name = f"tiler_plugin_{path.stem}"
    spec = spec_from_file_location(module_name, path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[module_name] = module  # Numba looks a function's module up there
    spec.loader.exec_module(module)


def _check_name(what: str, name: str, rest: str, table: dict[str, Any]) -> None:
    if not NAME.fullmatch(rest):
        raise TilerError(f"{what}: {name!r} is not allowed; allowed: lower-case letters, digits and _, a letter first")
    if name in table and name not in _origins:
        raise TilerError(f"{what}: {name!r} is built in; allowed: a name that is not taken")


def _only_one(what: str, name: str, functions: dict[str, Any]) -> Callable[..., Any]:
    given = {key: function for key, function in functions.items() if function is not None}
    if len(given) != 1:
        raise TilerError(f"{what} {name!r}: {len(given)} functions; allowed: one of {' and '.join(functions)}")
    ((key, function),) = given.items()
    if not callable(function):
        raise TilerError(f"{what} {name!r}: {key} is {type(function).__name__}; allowed: a function")
    return function


def _compiled(what: str, name: str, key: str, make: Callable[[Any], Any], function: Callable[..., Any]) -> Any:
    try:
        return make(function)
    except TypeError as error:
        raise TilerError(f"{what} {name!r}: {key} cannot be compiled: {error}") from None
