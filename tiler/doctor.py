"""What `tiler doctor` finds out about an installation."""

import importlib.metadata
import platform
import sys

DISTRIBUTION = "tilesim"
SHOWN = ("numpy", "numba", "llvmlite", "pillow", "pydantic", "cyclopts", "rich", "trimesh")


def diagnose() -> tuple[str, bool]:
    """A report, and whether all is well."""
    import pipeline.jit
    from tiler.host import available_threads
    from tiler.memory import available_bytes
    from tiler.scene import scene_names

    lines = [f"python     {platform.python_version()} on {platform.machine()}, {available_threads()} threads"]
    lines += [f"{name:<10} {_version(name)}" for name in (DISTRIBUTION, *SHOWN)]
    kernels = sorted(pipeline.jit.cache_root().rglob("*.nbi"))
    lines.append(f"kernels    {len(kernels)} cached in {pipeline.jit.cache_root()}")
    lines.append(f"memory     {available_bytes() / 1e9:.1f} GB available")
    names = scene_names()
    lines.append(f"scenes     {', '.join(names) if names else 'none found'}")
    problems = [] if names else ["no built-in scenes: reinstall, or set TILER_SCENES to their folder"]
    problems += _collisions()
    lines += [f"problem: {problem}" for problem in problems] or ["all is well"]
    return "\n".join(lines), not problems


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
