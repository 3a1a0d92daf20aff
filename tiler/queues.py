"""Tile queues as a result: how long each was, and how much memory all of them take by a stated layout.

`triangle` binning: each entry is a triangle number (4 bytes). Each binned triangle has a record of three vertex numbers
(12 bytes), and each vertex that a binned triangle uses is stored once after the transform: window position x, y, z and
1/w, and a normal (28 bytes). Vertices are shared within a patch, not between patches.

`subpatch` binning: each entry is a sub-domain number (4 bytes). Each sub-domain queued anywhere has a record of its patch
number (4 bytes) and its cell, four corners of 8 bits (4 bytes); each patch of which a sub-domain is queued has its factors.

`patch` binning: each entry is a patch number (4 bytes). Each patch queued anywhere has its six tessellation factors
stored once (24 bytes). Its control points are read again where the vertex stage left them: every machine writes those.
"""

from dataclasses import dataclass

from pipeline.types import I64
from tiler.queue_memory import QueueReport

ENTRY_BYTES = 4
TRIANGLE_BYTES = 12
VERTEX_BYTES = 28
PATCH_BYTES = 24
SUBPATCH_BYTES = 8


@dataclass(frozen=True)
class Queues:
    """entries : int64[tiles_y, tiles_x], entries of each tile's queue. bytes : all queues and their records, as laid out
    above. memory : the same by the machine's queue model.
    """

    entries: I64
    bytes: int
    memory: QueueReport


def queue_bytes(entries: int, triangles: int, vertices: int, patches: int, subpatches: int) -> int:
    """Bytes of a frame's queues with the records that their entries refer to; each argument a count."""
    records = triangles * TRIANGLE_BYTES + vertices * VERTEX_BYTES + patches * PATCH_BYTES + subpatches * SUBPATCH_BYTES
    return entries * ENTRY_BYTES + records
