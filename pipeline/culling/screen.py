"""What the float32 shader, the viewport and the snap may move a vertex by on the screen."""

from pipeline.jit import helper

U = 2.0**-24
CLIP_ERROR = 40.0 * U  # of a clip component, relative to its terms' magnitudes: 26 u position, 6 u matrix, rounded up
SNAP = 1.0 / 512.0
DENORMAL = 2.0**-118  # above what denormal products lose, after a division by LEAST_WEIGHT
LEAST_WEIGHT, MOST_WEIGHT = 2.0**-20, 2.0**20  # of control points; other patches are kept
MOST_PIXELS = 32000.0  # farther from pixel 0 the guard band is near


@helper
def clip_error(row, x, y, z):
    """What the float32 shader may be off in the clip component of a matrix row; x, y, z: largest magnitudes."""
    relative = CLIP_ERROR * (abs(row[0]) * x + abs(row[1]) * y + abs(row[2]) * z + abs(row[3]))
    return relative + DENORMAL * (abs(row[0]) + abs(row[1]) + abs(row[2])) + DENORMAL
