"""USD files: topology, creases, boundary rules, texture coordinates, transforms, several prims, and faults."""

import sys

import numpy as np
import pytest

import tiler
from pipeline.animate import pose
from tests.shared_data import shared_file
from tiler.errors import TilerWarning
from tiler.scene.arrays import ArrayFault
from tiler.scene.mesh_counts import count_mesh
from tiler.scene.mesh_files import read_mesh

QUAD = """
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
"""
ST = 'texCoord2f[] primvars:st = [(0, 0)] (interpolation = "vertex")\n'


def crease(indices, lengths, sharpnesses):
    return (
        f"int[] creaseIndices = {indices}\nint[] creaseLengths = {lengths}\nfloat[] creaseSharpnesses = {sharpnesses}\n"
    )


def usda(tmp_path, *prims):
    """A stage of Mesh prims `a`, `b` and so on, with these bodies."""
    text = "#usda 1.0\n" + "".join(f'def Mesh "{chr(97 + k)}"\n{{\n{body}\n}}\n' for k, body in enumerate(prims))
    (tmp_path / "stage.usda").write_text(text)
    return tmp_path / "stage.usda"


def read_one(tmp_path, body):
    (mesh,), warnings = read_mesh(usda(tmp_path, body))
    return mesh, warnings


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd", ".usdz"])
def test_a_model_goes_through_usd_unchanged(tmp_path, suffix):
    from pxr import Sdf, Usd, UsdGeom, UsdUtils

    (mesh,), _ = read_mesh(shared_file("data", "models", "monsterfrog.obj"))
    path = tmp_path / f"frog{'.usdc' if suffix == '.usdz' else suffix}"
    stage = Usd.Stage.CreateNew(str(path))
    prim = UsdGeom.Mesh.Define(stage, "/frog")
    prim.CreatePointsAttr(mesh.vertices.tolist())
    prim.CreateFaceVertexCountsAttr(np.diff(mesh.face_first).tolist())
    prim.CreateFaceVertexIndicesAttr(mesh.face_vertices.tolist())
    st = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set(mesh.texcoords.tolist())
    st.SetIndices(mesh.face_texcoords.tolist())
    stage.Save()
    del stage
    if suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(str(path), str(tmp_path / "frog.usdz"))
    (again,), warnings = read_mesh(tmp_path / f"frog{suffix}")
    assert warnings == () and again.name == "frog"
    for name in ("vertices", "face_first", "face_vertices", "texcoords", "face_texcoords"):
        a, b = getattr(mesh, name), getattr(again, name)
        assert np.array_equal(a, b) and a.dtype == b.dtype, name


def test_creases_corners_and_boundary(tmp_path):
    mesh, _ = read_one(
        tmp_path,
        QUAD
        + """int[] creaseIndices = [0, 1, 2, 3, 0]
        int[] creaseLengths = [3, 2]
        float[] creaseSharpnesses = [2.5, 10]
        int[] cornerIndices = [1, 2]
        float[] cornerSharpnesses = [4, 0]
        uniform token interpolateBoundary = "edgeOnly"
        """,
    )
    assert mesh.crease_edges.tolist() == [[0, 1], [1, 2], [3, 0]] and mesh.crease_sharpness.tolist() == [2.5, 2.5, 10]
    assert mesh.corner_vertices.tolist() == [1] and mesh.corner_sharpness.tolist() == [4]
    assert mesh.boundary == "edge_only"
    assert all(a.dtype == np.int32 for a in (mesh.crease_edges, mesh.corner_vertices))
    mesh, _ = read_one(
        tmp_path,
        QUAD + "int[] creaseIndices = [0, 1, 2]\nint[] creaseLengths = [3]\nfloat[] creaseSharpnesses = [1, 2]\n",
    )
    assert mesh.crease_sharpness.tolist() == [1, 2] and mesh.boundary == "edge_and_corner"


def test_texture_coordinates_of_every_kind(tmp_path):
    st = "texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 0.5)] ("
    for kind in ("faceVarying", "vertex", "varying"):
        mesh, warnings = read_one(tmp_path, f'{QUAD}{st}interpolation = "{kind}")')
        assert mesh.texcoords[mesh.face_texcoords].tolist() == [[0, 0], [1, 0], [1, 1], [0, 0.5]] and not warnings
    mesh, _ = read_one(tmp_path, f'{QUAD}{st}interpolation = "vertex")\nint[] primvars:st:indices = [3, 2, 1, 0]')
    assert mesh.texcoords[mesh.face_texcoords].tolist() == [[0, 0.5], [1, 1], [1, 0], [0, 0]]
    mesh, _ = read_one(
        tmp_path, QUAD + 'float2[] primvars:map1 = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")'
    )
    assert len(mesh.texcoords) == 4
    mesh, warnings = read_one(tmp_path, QUAD + 'texCoord2f[] primvars:st = [(0, 0)] (interpolation = "constant")')
    assert len(mesh.texcoords) == 0 and (mesh.face_texcoords == -1).all() and "st is constant" in warnings[0]


def test_sides_and_transforms(tmp_path):
    def front(body):
        mesh, _ = read_one(tmp_path, body)
        a, b, d = mesh.vertices[mesh.face_vertices[[0, 1, 3]]]
        return np.cross(b - a, d - a).tolist()

    assert front(QUAD) == [0, 0, 1]
    assert front(QUAD + 'uniform token orientation = "leftHanded"\n') == [0, 0, -1]
    mirror = 'double3 xformOp:scale = (-2, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]\n'
    assert front(QUAD + mirror) == [0, 0, 2]  # the object is mirrored, its front with it
    assert front(QUAD + mirror + 'uniform token orientation = "leftHanded"\n') == [0, 0, -2]
    mesh, _ = read_one(
        tmp_path, QUAD + 'double3 xformOp:translate = (5, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'
    )
    assert mesh.vertices.tolist() == [[5, 0, 1], [6, 0, 1], [6, 1, 1], [5, 1, 1]]


def test_several_prims_and_parents(tmp_path):
    nested = f"""#usda 1.0
def Xform "root"
{{
    double3 xformOp:translate = (0, 0, 7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "one"
    {{{QUAD}
    }}
    def Mesh "empty"
    {{
    }}
    def Mesh "two"
    {{{QUAD}
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
}}
"""
    (tmp_path / "n.usda").write_text(nested)
    meshes, warnings = read_mesh(tmp_path / "n.usda")
    assert [m.name for m in meshes] == ["one", "two"] and warnings == ()
    assert [m.vertices[0].tolist() for m in meshes] == [[0, 0, 7], [1, 0, 7]]
    assert [count_mesh(m).faces for m in meshes] == [1, 1]


def test_warnings(tmp_path):
    body = QUAD + 'uniform token subdivisionScheme = "none"\n'
    assert "/a: subdivisionScheme none" in read_one(tmp_path, body)[1][0]


THREE = "(0, 0, 0), (1, 0, 0), (1, 1, 0)"  # and the fourth moves, and a fifth that no face names
SAMPLES = f"{{1: [{THREE}, (0, 1, 0), (9, 9, 9)], 4: [{THREE}, (0, 1, 6), (9, 9, 9)]}}"
MOVING = QUAD.replace("points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]", f"points.timeSamples = {SAMPLES}")


def test_points_that_move_are_keys(tmp_path):
    """The vertex that no face names is dropped from the keys too; the model's scene has the file's frames."""
    mesh, warnings = read_one(tmp_path, MOVING)
    assert len(warnings) == 1 and "dropped" in warnings[0] and mesh.vertices[3].tolist() == [0, 1, 0]
    assert mesh.keys.frames.tolist() == [1, 4] and mesh.keys.points.shape == (2, 4, 3)
    assert mesh.keys.points[1, 3].tolist() == [0, 1, 6] and mesh.keys.points.dtype == np.float32
    with pytest.warns(TilerWarning, match="dropped"):
        scene = tiler.load_scene(usda(tmp_path, MOVING))
    (motion,), (surface,) = scene.motions, scene.meshes
    assert scene.frames == 5
    heights = [pose(surface.vertices, motion, frame)[3, 2] for frame in (0, 1, 2, 3, 4, 9)]
    assert heights == [0, 0, 2, 4, 6, 6]


def test_transforms_that_move_are_keys_too(tmp_path):
    """Of the prim and of what is above it; two prims with keys of their own make one motion."""
    text = f"""#usda 1.0
def Xform "root"
{{
    double3 xformOp:translate.timeSamples = {{ 0: (0, 0, 0), 10: (0, 0, 10) }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "one"
    {{{MOVING}
    }}
}}
def Mesh "still"
{{{QUAD}
}}
"""
    (tmp_path / "n.usda").write_text(text)
    (one, still), _ = read_mesh(tmp_path / "n.usda")
    assert one.keys.frames.tolist() == [0, 1, 4, 10] and still.keys is None
    with pytest.warns(TilerWarning, match="dropped"):
        scene = tiler.load_scene(tmp_path / "n.usda")
    for frame, z, last in ((0, 0, 0), (1, 1, 1), (4, 4, 10), (7, 7, 13), (10, 10, 16)):
        points = pose(scene.meshes[0].vertices, scene.motions[0], frame)
        assert points[:, 2].tolist() == [z, z, z, last, 0, 0, 0, 0]


def test_number_of_points_may_not_change(tmp_path):
    body = MOVING.replace(", (9, 9, 9)]}", "]}")
    with pytest.raises(ArrayFault, match="has 4 points at time 4; allowed: 5"):
        read_one(tmp_path, body)


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_the_stage_says_which_way_is_up(tmp_path, up):
    path = tmp_path / "up.usda"
    path.write_text(f'#usda 1.0\n(\n    upAxis = "{up}"\n)\ndef Mesh "a"\n{{\n{QUAD}\n}}\n')
    scene = tiler.load_scene(path)
    assert scene.camera.up == ((0, 1, 0) if up == "Y" else (0, 0, 1)) and scene.title.endswith(f"{up.lower()} up")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", ["1 Mesh prims, none with a face"]),
        (QUAD + 'uniform token subdivisionScheme = "loop"\n', ["/a", "loop", "catmullClark, none"]),
        (QUAD + 'uniform token subdivisionScheme = "bilinear"\n', ["bilinear"]),
        (QUAD.replace("2, 3]", "2, 4]"), ["/a", "faceVertexIndices[3] is 4", "0 to 3"]),
        (QUAD.replace("2, 3]", "2, -1]"), ["faceVertexIndices[3] is -1"]),
        (QUAD.replace("2, 3]", "2, 0]"), ["face 0 names vertex 0 twice"]),
        (QUAD.replace("[4]", "[2, 2]"), ["faceVertexCounts[0] is 2"]),
        (QUAD.replace("[4]", "[5]"), ["add up to 5", "4 faceVertexIndices"]),
        (QUAD.replace("[4]", "[100000000]"), ["add up to 100000000"]),
        (QUAD + crease([0, 9], [2], [1]), ["creaseIndices has 9"]),
        (QUAD + crease([0, 1, 2], [2], [1]), ["creaseLengths [2]"]),
        (QUAD + crease([0, 1], [2], [1, 2, 3]), ["3 creaseSharpnesses"]),
        (QUAD + "int[] cornerIndices = [0]\n", ["1 cornerIndices and 0"]),
        (QUAD + ST, ["primvar st has 1 vertex values; needed: 4"]),
        (QUAD + ST + "int[] primvars:st:indices = [0, 0, 1, 0]\n", ["has index 1"]),
    ],
)
def test_faults(tmp_path, body, words):
    with pytest.raises(ArrayFault) as caught:
        read_mesh(usda(tmp_path, body))
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_broken_files(tmp_path):
    for name, data in (
        ("a.usda", b"#usda 1.0\ndef Mesh {"),
        ("a.usdc", b"PXR-USDC junk"),
        ("a.usd", b""),
        ("a.usdz", b"PK"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ArrayFault, match="no USD file that can be read"):
            read_mesh(tmp_path / name)
    with pytest.raises(ArrayFault, match="does not exist"):
        read_mesh(tmp_path / "none.usda")
    with pytest.raises(ArrayFault, match=r"\(line 2: not valid\)"):
        read_mesh(tmp_path / "a.usda")


def test_missing_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(ArrayFault, match=r"pip install 'tilesim\[usd\]'"):
        read_mesh(usda(tmp_path, QUAD))
