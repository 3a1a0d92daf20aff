"""How much memory a frame may take: asked before anything is allocated."""

import math
import os
import time
from pathlib import Path

from tiler.config import Machine
from tiler.errors import TilerError
from tiler.host import CHUNKS_PER_THREAD
from tiler.scene.model import Picture
from tiler.tile import NUM_TILE_COUNTS

FRESH_SECONDS = 0.5  # for which an answer holds: to ask the system takes as long as to set up 10,000 triangles

_answer = (-math.inf, 0)  # when it was given, and what it was


def available_bytes() -> int:
    """Memory that this process can still get: the machine's, or its control group's where that is less.

    As it was at most FRESH_SECONDS ago.
    """
    global _answer
    now, (then, known) = time.monotonic(), _answer
    if now - then < FRESH_SECONDS:
        return known
    found = _ask_system()
    _answer = (now, found)
    return found


def _ask_system() -> int:
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


def picture_bytes(picture: Picture, machine: Machine, threads: int) -> int:
    """Bytes of all arrays of a frame whose size follows from the picture: targets, pyramids, tables of the tiles."""
    samples = picture.width * picture.height * picture.samples
    per_sample = 4 + 4 + 4  # depth, visible triangle, colour
    if machine.reordered or machine.blame:
        per_sample += 8  # submit number
    if machine.phased:
        per_sample += 4  # depth of the last frame; the rest of its target is gone when this frame's is made
    if machine.blame:
        per_sample += 4 + 8  # depth and submit number of the second drawing
    total = samples * per_sample
    if picture.samples > 1:
        total += picture.width * picture.height * 4  # the resolved colour
    if machine.occlusion:
        block = machine.coarse_z_block
        blocks = -(-picture.width // block) * -(-picture.height // block)
        total += (
            (2 if machine.phased else 1) * 8 * -(-4 * blocks // 3)
        )  # farthest and nearest; a third of it for upper levels
    tiles = -(-picture.width // machine.tile) * -(-picture.height // machine.tile)
    columns = 2 * NUM_TILE_COUNTS + 3 * CHUNKS_PER_THREAD * threads  # counters and their maps; the places of binning
    if machine.binning == "triangle":
        columns += NUM_TILE_COUNTS + 3 + threads  # what regions count, the patch that fills each tile most, its entries
    return total + tiles * 8 * columns


def check_picture(picture: Picture, machine: Machine, threads: int) -> None:
    """Raise TilerError if what a frame of such a picture takes on this machine does not fit into the memory available."""
    needed, available = picture_bytes(picture, machine, threads), available_bytes()
    if needed > available:
        raise TilerError(
            f"picture: {picture.width} x {picture.height} with {picture.samples} sample(s), in tiles of {machine.tile}, "
            f"takes {needed / 1e9:.1f} GB; allowed: what fits into the {available / 1e9:.1f} GB available"
        )
