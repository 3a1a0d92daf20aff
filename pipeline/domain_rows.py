"""The domain shader's scratch: rows of float32, one entry a point of a block, at constant distances in one array.

So LLVM sees without run-time checks that no store meets a later load, and vectorizes every pass but the texture's gathers.
A block is filled up to a multiple of LANES points, and so are the passes: a remainder would run point by point, and of 81
points it would be the larger part of the time.
"""

import numpy as np

from pipeline.jit import helper

LANES = 8  # points at once: a 256-bit vector
BLOCK = 296  # most points in a block: one of 17 x 17 points, filled up; the rows in use stay in the first-level cache
ROW = BLOCK + LANES  # a row has room for one vector more, as runs of points may begin at any place

# (u, v); point; tangents A and B along u and v, later the normal for the pixel shader in A; normal N; S: 1 where N is safe.
U, V, PX, PY, PZ, AX, AY, AZ, BX, BY, BZ, NX, NY, NZ, S = (k * ROW for k in range(15))
# Displacement and its derivatives along u and v; fractions of texel coordinates; numbers (int32) of the texels' columns and
# of the first texels of their lines; displacement by vectors.
T, GU, GV, FX, FY, I0, I1, J0, J1, DX, DY, DZ = (k * ROW for k in range(15, 27))
# Clip position; before it the four texels, and working space of edge normals.
CX, CY, CZ, CW = (k * ROW for k in range(27, 31))
T00, T10, T01, T11 = CX, CY, CZ, CW

# Sums over i of a patch, for each u of a row of its pattern: four, four and three of each coordinate. A row repeats its
# beginning, so that a vector may begin anywhere in it.
MOST_COLUMNS = 65  # points on a side of the finest pattern
TABLE_ROW = 72
TABLE_U = 31 * ROW
TABLE = TABLE_U + TABLE_ROW

# Control points and texture coordinates of the patch at hand.
NETS = TABLE + 33 * TABLE_ROW
CORNERS = NETS + 64

SCRATCH = CORNERS + 8  # float32 entries that the caller provides

POSITIVE = 511  # mask of places in a row: tells the compiler that they are not negative, and that they stay in the row

ONE = np.float32(1.0)
ZERO = np.float32(0.0)
TINY = np.float32(2.0**-100)  # squared length of du x dv below which float32 may have lost it to underflow
HUGE = np.float32(2.0**100)


@helper
def filled(n):
    """n points and those that fill up the last vector."""
    return (n + LANES - 1) // LANES * LANES
