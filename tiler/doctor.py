"""What `tiler doctor` finds out about an installation."""

import importlib.metadata
import platform
import sys
from typing import Any

DISTRIBUTION = "tilesim"
SHOWN = ("numpy", "numba", "llvmlite", "pillow", "pydantic", "cyclopts", "rich", "trimesh")


def diagnose() -> dict[str, Any]:
    """What there is, by name; `problems` says what is wrong, a sentence each."""
    import pipeline.jit
    from tiler.host import available_threads
    from tiler.memory import available_bytes
    from tiler.scene import scene_names

    names = list(scene_names())
    problems = [] if names else ["no built-in scenes: reinstall, or set TILER_SCENES to their folder"]
    return {
        "python": platform.python_version(),
        "processor": platform.machine(),
        "threads": available_threads(),
        "versions": {name: _version(name) for name in (DISTRIBUTION, *SHOWN)},
        "kernels": len(sorted(pipeline.jit.cache_root().rglob("*.nbi"))),
        "kernel_cache": str(pipeline.jit.cache_root()),
        "memory_bytes": available_bytes(),
        "scenes": names,
        "problems": problems + _collisions(),
    }


def report_text(found: dict[str, Any]) -> str:
    """The same for people."""
    lines = [f"python     {found['python']} on {found['processor']}, {found['threads']} threads"]
    lines += [f"{name:<10} {version}" for name, version in found["versions"].items()]
    lines.append(f"kernels    {found['kernels']} cached in {found['kernel_cache']}")
    lines.append(f"memory     {found['memory_bytes'] / 1e9:.1f} GB available")
    lines.append(f"scenes     {', '.join(found['scenes']) or 'none found'}")
    lines += [f"problem: {problem}" for problem in found["problems"]] or ["all is well"]
    return "\n".join(lines)


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _collisions() -> list[str]:
    """Other distributions that install a package of one of our names, and so overwrite ours without a word."""
    owners = importlib.metadata.packages_distributions()
    found = []
    for package in ("tiler", "pipeline"):
        others = sorted(set(owners.get(package, [])) - {DISTRIBUTION})
        if others:
            found.append(
                f"{', '.join(others)} also installs a package named {package!r}; "
                f"run `{sys.executable} -m pip uninstall {' '.join(others)}` and reinstall {DISTRIBUTION}"
            )
    return found
