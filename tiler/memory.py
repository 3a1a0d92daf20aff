"""How much memory a frame may take: asked before anything is allocated."""

import os
from pathlib import Path

from tiler.errors import TilerError


def available_bytes() -> int:
    """Memory that this process can still get: the machine's, or its control group's where that is less."""
    free = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free.append(int(line.split()[1]) * 1024)
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit != "max":
            free.append(int(limit) - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    except OSError:
        pass
    if not free:
        free.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(0, min(free))


def check_picture(width: int, height: int, samples: int) -> None:
    """Raise TilerError if the render target of such a picture does not fit into the memory available."""
    pixel = samples * (4 + 4 + 4) + (4 if samples > 1 else 0)  # depth, visible triangle, colour; the resolved colour
    needed, available = width * height * pixel, available_bytes()
    if needed > available:
        raise TilerError(
            f"picture: {width} x {height} with {samples} sample(s) takes {needed / 1e9:.1f} GB; "
            f"allowed: what fits into the {available / 1e9:.1f} GB available"
        )
