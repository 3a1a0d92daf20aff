"""Where a result comes from: versions, commit, and the machine that it was computed on."""

import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tiler import __version__
from tiler.host import available_threads

ROOT = Path(__file__).resolve().parent.parent


def provenance() -> dict[str, str]:
    """Names and texts, none of them empty of meaning on another machine."""
    return {
        "version": __version__,
        "commit": commit(),
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "numba": _version("numba"),
        "llvmlite": _version("llvmlite"),
        "platform": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cpu": cpu_model(),
        "cores": str(available_threads()),
        "byte_order": sys.byteorder,
    }


def commit() -> str:
    """Commit of the checkout that the package lies in, `+changes` where files differ from it; "" outside of one."""
    if not (ROOT / ".git").exists():
        return ""
    head = _git("rev-parse", "HEAD")
    return head + ("+changes" if head and _git("status", "--porcelain", "--untracked-files=no") else "")


def cpu_model() -> str:
    """The processor's name as the system tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "unknown"
