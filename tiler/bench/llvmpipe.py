"""Mesa's llvmpipe as the renderer that a user could pick instead: one scene, drawn frame by frame in a child process.

GL lives in a child of its own: the environment is set before libEGL loads, LP_NUM_THREADS is read once there, libLLVM
keeps away from Numba's own, and a crash there is a message here.

A frame is: clear, draw, finish; nothing is read back. Draws are split so that each makes at most POINTS domain points:
Mesa's draw module indexes a draw with 16 bits and draws more than 65,535 points wrongly, without a word; and this size is
its fastest. Clip space and origin are Direct3D's (upper left, 0 <= z <= w), so memory row 0 is the top row.
"""

import ctypes
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np

from pipeline.types import F32, I32
from tiler.errors import TilerError
from tiler.scene.model import Scene

LAYOUT = ("4f 2f", "position", "texcoord")
PLAIN_LAYOUT = ("4f 2x4", "position")  # the compiler drops the texture corners
POINTS = 4700  # most domain points of one draw
EGL_DEVICES = 4  # on a machine with GPUs the software device is not the first
SPACING = {
    "integer": "equal_spacing",
    "fractional_odd": "fractional_odd_spacing",
    "fractional_even": "fractional_even_spacing",
}
NEEDED = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libgl1, and pip install 'tilesim[gl]'"

CLIP_CONTROL = (0x8CA2, 0x935F)  # GL_UPPER_LEFT, GL_ZERO_TO_ONE
STATISTICS = {
    "ds_invocations": 0x82F2,  # GL_TESS_EVALUATION_SHADER_INVOCATIONS
    "hs_invocations": 0x82F1,  # GL_TESS_CONTROL_SHADER_PATCHES
    "om_samples_passed": 0x8914,  # GL_SAMPLES_PASSED
}


class Drawing(NamedTuple):
    """A scene as the child draws it; plain arrays, which travel to another process."""

    vertices: F32  # (P, 16, 6) world-space homogeneous control point; texture corner k at control point k < 4
    map_id: I32  # (P,)
    maps: tuple[tuple[F32, bool, float, float], ...]  # texels, whether they repeat, scale, bias
    clip_from_world: F32
    factor: tuple[float, ...]
    spacing: str
    size: tuple[int, int]
    background: tuple[int, int, int]
    light: tuple[float, float, float]
    clay: tuple[float, ...]
    ambient: tuple[float, ...]
    face_cull: str


class Picture(NamedTuple):
    """What the last frame left."""

    color: np.ndarray  # uint8[H, W, 4]
    depth: F32  # (H, W)
    counters: dict[str, int]


def drawing_of(scene: Scene, frame: float = 0) -> Drawing:
    """The scene for llvmpipe. Raises TilerError for what this renderer here cannot draw alike."""
    from pipeline import pixel
    from tiler import back_end, front_end
    from tiler.scene.camera import camera_at

    policy, picture = scene.tessellation, scene.picture
    wrong = [
        f"{what}; allowed: {allowed}"
        for refused, what, allowed in (
            (policy.edge_pixels is not None, "edge_pixels is not allowed", "a fixed factor"),
            (policy.silhouette != 1.0, "silhouette is not allowed", "1"),
            (
                policy.partitioning not in SPACING,
                f"partitioning {policy.partitioning!r} is not allowed",
                ", ".join(SPACING),
            ),
            (picture.samples != 1, f"{picture.samples} samples are not allowed", "1"),
            (picture.shading != "lambert", f"shading {picture.shading!r} is not allowed", "lambert"),
            (any(m.address == "mirror" for m in scene.maps), "a mirrored map is not allowed", "wrap, clamp"),
            (any(m.texels.ndim == 3 for m in scene.maps), "a map of vectors is not allowed", "scalar maps"),
        )
        if refused
    ]
    if wrong:
        raise TilerError("\n".join(f"peer: scene {scene.name!r}: {line}" for line in wrong))
    camera = camera_at(scene.camera, frame, picture.width / picture.height)
    patches = front_end.run_vertex_shader(scene, frame)
    vertices = np.zeros((scene.num_patches, 16, 6), np.float32)
    vertices[..., :4] = patches.control_points.reshape(-1, 16, 4)
    vertices[:, :4, 4:] = patches.texcoords
    return Drawing(
        vertices,
        patches.map_id,
        tuple((m.texels, m.address == "wrap", m.scale, m.bias) for m in scene.maps),
        camera.clip_from_world,
        policy.factor,
        SPACING[policy.partitioning],
        (picture.width, picture.height),
        picture.background,
        back_end.unit_vector(scene.light),
        tuple(float(c) for c in pixel.CLAY),
        tuple(float(c) for c in pixel.AMBIENT),
        scene.face_cull,
    )


class Renderer:
    """A child process that holds a GL context of llvmpipe with `threads` raster threads beside the drawing one; a context
    manager. Raises TilerError where llvmpipe is not installed."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        self.name: str = self._call(_open, threads, missing=f"is not available; it takes {NEEDED}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        self._pool.shutdown(cancel_futures=True)

    def load(self, drawing: Drawing) -> None:
        """Set a scene up: programs, buffers, textures, target."""
        self._call(_load, drawing)

    def draw(self) -> tuple[float, float]:
        """Draw a frame: its seconds, and processor seconds of all threads, measured in the child."""
        seconds: tuple[float, float] = self._call(_draw)
        return seconds

    def read(self) -> Picture:
        """Draw a frame with GL's pipeline statistics on, and read it back."""
        picture: Picture = self._call(_read)
        return picture

    def _call(self, function: Any, *arguments: Any, missing: str = "cannot draw this") -> Any:
        try:
            return self._pool.submit(function, *arguments).result(timeout=600)
        except BrokenProcessPool:
            raise TilerError(f"peer: llvmpipe {missing}: its process died") from None
        except Exception as error:  # no driver, no moderngl, an old GL: each has its own class
            # A pool that is closed without waiting writes to its own closed pipe where the interpreter ends in that moment;
            # a child that hangs is not waited for.
            self._pool.shutdown(wait=not isinstance(error, TimeoutError), cancel_futures=True)
            raise TilerError(f"peer: llvmpipe {missing}: {type(error).__name__}: {error}") from None


# What follows runs in the child process.

_state: dict[str, Any] = {}


def _open(threads: int) -> str:
    os.environ.update(
        LIBGL_ALWAYS_SOFTWARE="1", GALLIUM_DRIVER="llvmpipe", EGL_PLATFORM="surfaceless", MESA_SHADER_CACHE_DISABLE="1",
        LP_NUM_THREADS=str(threads),
    )  # fmt: skip
    import moderngl

    options: Any = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
    failures = []
    for device in range(EGL_DEVICES):
        try:
            options["device_index"] = device
            context: Any = moderngl.create_context(standalone=True, require=450, **options)
        except Exception as error:  # glcontext raises bare Exception
            failures.append(f"device {device}: {error}")
            continue
        name = str(context.info["GL_RENDERER"])
        if name.startswith("llvmpipe"):
            _state["context"] = context
            _function("glClipControl", ctypes.c_uint, ctypes.c_uint)(*CLIP_CONTROL)
            return f"{name}, {context.info['GL_VERSION']}"
        failures.append(f"device {device}: it is {name}")
        context.release()
    raise RuntimeError("; ".join(failures))


def _function(name: str, *arguments: Any) -> Any:
    """A GL function that moderngl does not have."""
    address = ctypes.CDLL("libEGL.so.1").eglGetProcAddress
    address.restype, address.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None, *arguments)(address(name.encode()))


def _load(drawing: Drawing) -> None:
    from tiler.bench import llvmpipe_shaders as shaders

    context: Any = _state["context"]
    for kept in _state.pop("kept", []):
        kept.release()
    rational = bool((drawing.vertices[..., 3] != 1.0).any())
    program = {}
    for displaced in np.unique(drawing.map_id >= 0):
        source = shaders.TESS_EVALUATION.replace("@SPACING@", drawing.spacing)
        source = source.replace("@DISPLACED@", str(int(displaced))).replace("@RATIONAL@", str(int(rational)))
        program[bool(displaced)] = context.program(
            vertex_shader=shaders.VERTEX,
            tess_control_shader=shaders.TESS_CONTROL,
            tess_evaluation_shader=source,
            fragment_shader=shaders.FRAGMENT,
        )
    for made in program.values():
        made["clip_from_world"].write(np.ascontiguousarray(drawing.clip_from_world.T).tobytes())
        made["factor"].value = drawing.factor
        for name in ("light", "clay", "ambient"):
            made[name].value = getattr(drawing, name)
    buffer = context.buffer(drawing.vertices.tobytes())
    meshes = {
        displaced: context.vertex_array(made, [(buffer, *(LAYOUT if displaced else PLAIN_LAYOUT))])
        for displaced, made in program.items()
    }
    textures = []
    for texels, repeats, _, _ in drawing.maps:
        texture = context.texture(texels.shape[::-1], 1, np.ascontiguousarray(texels).tobytes(), dtype="f4")
        texture.filter = (context.LINEAR, context.LINEAR)
        texture.repeat_x = texture.repeat_y = repeats
        textures.append(texture)
    target = context.framebuffer([context.renderbuffer(drawing.size, 4)], context.depth_renderbuffer(drawing.size))
    target.use()
    target.viewport = (0, 0, *drawing.size)
    context.enable_only(context.DEPTH_TEST)
    context.depth_func = "<"
    if drawing.face_cull != "none":
        context.enable(context.CULL_FACE)
        context.front_face = "cw"
        context.cull_face = drawing.face_cull
    context.patch_vertices = 16
    _state.update(drawing=drawing, meshes=meshes, program=program, textures=textures, target=target)
    _state["kept"] = [*meshes.values(), *program.values(), buffer, *textures, target]
    _state["draws"] = _split(drawing)
    _frame()  # compiles the shaders


def _split(drawing: Drawing) -> list[tuple[int, int, int]]:
    """Draws (first patch, patches, map), in submit order, of at most POINTS domain points each."""
    points = (np.ceil(max(drawing.factor)) + 2) ** 2
    most = max(1, int(POINTS // points))
    runs = np.flatnonzero(np.diff(drawing.map_id)) + 1
    ends = [0, *runs.tolist(), len(drawing.map_id)]
    draws = []
    for begin, end in pairwise(ends):
        for first in range(begin, end, most):
            draws.append((first, min(most, end - first), int(drawing.map_id[begin])))
    return draws


def _frame() -> None:
    context, drawing = _state["context"], _state["drawing"]
    red, green, blue = (c / 255 for c in drawing.background)
    _state["target"].clear(red, green, blue, 1.0, depth=1.0)
    meshes, now = _state["meshes"], None
    for first, count, m in _state["draws"]:
        if m != now:
            now = m
            if m >= 0:
                made = _state["program"][True]
                _state["textures"][m].use(location=0)
                made["map"].value = 0
                made["scale"].value, made["bias"].value = drawing.maps[m][2:]
        meshes[m >= 0].render(mode=context.PATCHES, vertices=16 * count, first=16 * first)
    context.finish()


def _draw() -> tuple[float, float]:
    start, cpu = time.perf_counter(), time.process_time()
    _frame()
    return time.perf_counter() - start, time.process_time() - cpu


def _read() -> Picture:
    target = _state["target"]
    width, height = _state["drawing"].size
    counters = {}
    names = (ctypes.c_uint * 1)()
    value = ctypes.c_uint64()
    uint = ctypes.c_uint
    for counter, kind in STATISTICS.items():
        _function("glGenQueries", ctypes.c_int, ctypes.c_void_p)(1, ctypes.addressof(names))
        _function("glBeginQuery", uint, uint)(kind, names[0])
        _frame()
        _function("glEndQuery", uint)(kind)
        _function("glGetQueryObjectui64v", uint, uint, ctypes.c_void_p)(names[0], 0x8866, ctypes.addressof(value))
        _function("glDeleteQueries", ctypes.c_int, ctypes.c_void_p)(1, ctypes.addressof(names))
        counters[counter] = value.value
    color = np.frombuffer(target.read(components=4, alignment=1), np.uint8).reshape(height, width, 4)
    raw = target.read(attachment=-1, components=1, dtype="f4", alignment=1)
    return Picture(color, np.frombuffer(raw, np.float32).reshape(height, width), counters)
