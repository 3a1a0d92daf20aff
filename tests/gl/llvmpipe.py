"""Which samples Mesa's llvmpipe covers: an oracle for triangle coverage that is not our code.

One draw holds many triangles, each in a cell of its own on one 2048x2048 target (an atlas); a fragment that falls
outside its triangle's cell is discarded, so triangles may stick out of their cells. The viewport is larger than the
target by MARGIN on each side, so nothing is clipped: llvmpipe would snap the vertices that clipping makes.

Orientation: the clip origin stays at its default and ndc_y grows with the window's y, so memory row 0 is the top row of
the D3D window and the fill rule is D3D's top-left. All sizes are powers of two: positions that are multiples of 1/4096
pixel pass through NDC and viewport without rounding, and llvmpipe alone snaps them to 1/256 pixel.

GL lives in a child process, started at the first call. It gets its environment before libEGL loads, keeps libLLVM away
from Numba's own, and a crash there is a message here.
"""

import functools
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import numpy as np

SIZE = 2048  # pixels, width and height of the target
MARGIN = 1024  # pixels that a triangle may reach beyond its cell
ENVIRONMENT = {
    "LIBGL_ALWAYS_SOFTWARE": "1",
    "GALLIUM_DRIVER": "llvmpipe",
    "EGL_PLATFORM": "surfaceless",
    "MESA_SHADER_CACHE_DISABLE": "1",
}
EGL_DEVICES = 4  # on a machine with GPUs the software device is not the first

TRIANGLE_VERTEX = """
#version 330 core
uniform int cells_in_row;
uniform ivec2 cell_size;
in vec2 ndc;
flat out ivec2 origin;
void main() {
    int cell = gl_VertexID / 3;
    origin = ivec2(cell % cells_in_row, cell / cells_in_row) * cell_size;
    gl_Position = vec4(ndc, 0.0, 1.0);
}
"""

TRIANGLE_FRAGMENT = """
#version 330 core
uniform ivec2 cell_size;
flat in ivec2 origin;
out float mask;
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - origin;
    if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, cell_size))) discard;
    mask = 1.0 / 255.0;
}
"""

WHOLE_TARGET_VERTEX = """
#version 330 core
void main() {
    gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}
"""

# Bit s of the result is sample s, by GL's sample number.
GATHER_FRAGMENT = """
#version 330 core
uniform sampler2DMS drawn;
out float mask;
void main() {
    int bits = 0;
    for (int s = 0; s < 4; ++s)
        if (texelFetch(drawn, ivec2(gl_FragCoord.xy), s).r > 0.0) bits |= 1 << s;
    mask = float(bits) / 255.0;
}
"""


@functools.cache
def available() -> str | None:
    """None when llvmpipe answers, else the reason why it does not."""
    try:
        _process().submit(_open).result(timeout=120)
    except BrokenProcessPool:
        return "llvmpipe is not available: the process that opened a GL context died"
    except Exception as error:  # no driver, no moderngl, an old GL: each has its own class
        return f"llvmpipe is not available: {type(error).__name__}: {error}"
    return None


def coverage_1x(triangles: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pixels whose centre each triangle covers, by itself, on a window of width x height.

    triangles : float64 or float32[T, 3, 2], window positions in pixels, x right and y down, multiples of 1/4096, at
    most MARGIN outside of the window. Returns bool[T, height, width, 1].
    """
    return _coverage(triangles, width, height, 1)


def coverage_4x(triangles: np.ndarray, width: int, height: int) -> np.ndarray:
    """As `coverage_1x`, on a target with four samples a pixel: bool[T, height, width, 4], by sample number."""
    return _coverage(triangles, width, height, 4)


def _coverage(triangles: np.ndarray, width: int, height: int, samples: int) -> np.ndarray:
    triangles = np.asarray(triangles, dtype=np.float64)
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 2):
        raise ValueError(f"triangles must be an array of shape (T, 3, 2), got {triangles.shape}")
    if not (0 < width <= SIZE and 0 < height <= SIZE):
        raise ValueError(f"width and height must be in 1..{SIZE}, got {width}, {height}")
    if not np.array_equal(triangles * 4096, np.rint(triangles * 4096)):
        raise ValueError("positions must be multiples of 1/4096 pixel: GL's float32 would round others before the snap")
    if (triangles < -MARGIN).any() or (triangles > np.array([width, height]) + MARGIN).any():
        raise ValueError(f"positions must lie at most {MARGIN} pixels outside of the window: others would be clipped")
    if (reason := available()) is not None:
        raise RuntimeError(reason)
    masks = _process().submit(_draw_all, triangles, width, height, samples).result()
    return np.stack([(masks >> s) & 1 for s in range(samples)], axis=-1).view(bool)


@functools.cache
def _process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))


# What follows runs in the child process.


def _open() -> None:
    _programs()


@functools.cache
def _context() -> Any:
    os.environ.update(ENVIRONMENT)
    import moderngl

    failures = []
    for device in range(EGL_DEVICES):
        try:
            context = moderngl.create_context(
                standalone=True,
                require=330,
                backend="egl",
                libgl="libGL.so.1",
                libegl="libEGL.so.1",
                device_index=device,
            )
        except Exception as error:  # glcontext raises bare Exception
            failures.append(f"device {device}: {error}")
            continue
        if str(context.info["GL_RENDERER"]).startswith("llvmpipe"):
            return context
        failures.append(f"device {device}: it is {context.info['GL_RENDERER']}")
        context.release()
    raise RuntimeError("; ".join(failures))


@functools.cache
def _programs() -> tuple[Any, Any]:
    context = _context()
    return (
        context.program(vertex_shader=TRIANGLE_VERTEX, fragment_shader=TRIANGLE_FRAGMENT),
        context.program(vertex_shader=WHOLE_TARGET_VERTEX, fragment_shader=GATHER_FRAGMENT),
    )


@functools.cache
def _target(samples: int) -> Any:
    context = _context()
    return context.framebuffer([context.texture((SIZE, SIZE), 1, samples=0 if samples == 1 else samples)])


def _draw_all(triangles: np.ndarray, width: int, height: int, samples: int) -> np.ndarray:
    """uint8[T, height, width], bit s set where sample s is covered."""
    in_row, in_column = SIZE // width, SIZE // height
    masks = np.empty((len(triangles), height, width), np.uint8)
    for first in range(0, len(triangles), in_row * in_column):
        batch = triangles[first : first + in_row * in_column]
        atlas = _draw_atlas(batch, width, height, samples)
        atlas = atlas[: in_column * height, : in_row * width].reshape(in_column, height, in_row, width)
        cell = np.arange(len(batch))
        masks[first : first + len(batch)] = atlas[cell // in_row, :, cell % in_row, :]
    return masks


def _draw_atlas(triangles: np.ndarray, width: int, height: int, samples: int) -> np.ndarray:
    """uint8[SIZE, SIZE]: triangle t in cell t, all in one draw."""
    context, (draw, gather) = _context(), _programs()
    cell = np.arange(len(triangles))
    in_row = SIZE // width
    origin = np.stack([cell % in_row * width, cell // in_row * height], axis=-1)
    half = SIZE / 2 + MARGIN  # half the viewport's size
    ndc = ((triangles + origin[:, None, :] + MARGIN) / half - 1).astype(np.float32)

    target = _target(samples)
    target.use()
    target.viewport = (-MARGIN, -MARGIN, SIZE + 2 * MARGIN, SIZE + 2 * MARGIN)
    target.clear(viewport=(0, 0, SIZE, SIZE))
    context.disable(context.CULL_FACE | context.DEPTH_TEST | context.BLEND)
    draw["cells_in_row"].value = in_row
    draw["cell_size"].value = (width, height)
    vertices = context.buffer(ndc.tobytes())
    mesh = context.vertex_array(draw, [(vertices, "2f", "ndc")])
    mesh.render(mode=context.TRIANGLES)
    mesh.release()
    vertices.release()

    if samples > 1:
        drawn, target = target.color_attachments[0], _target(1)
        target.use()
        target.viewport = (0, 0, SIZE, SIZE)
        drawn.use(location=0)
        gather["drawn"].value = 0
        whole = context.vertex_array(gather, [])
        whole.render(mode=context.TRIANGLES, vertices=3)
        whole.release()
    raw = target.read(viewport=(0, 0, SIZE, SIZE), components=1, alignment=1)
    return np.frombuffer(raw, np.uint8).reshape(SIZE, SIZE)
