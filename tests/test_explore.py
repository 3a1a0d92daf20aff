"""The explorer without a browser: who may ask and for what; a tile's entries add up, boxes are the bounds."""

import http.client
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tiler
from pipeline.bounds import BOUNDS
from tests.scenes import patch_scene
from tiler import cli
from tiler.config import TILE_SIZES
from tiler.errors import TilerError
from tiler.explore import session as session_module
from tiler.explore import tile_queue
from tiler.explore.forms import field_texts, machine_form, presets
from tiler.explore.patch_boxes import EDGES, REACH, box_lines, hull_stage
from tiler.explore.requests import Ask, change_scene, draft_size, make_machine, read_ask
from tiler.explore.server import Explorer, listen
from tiler.explore.session import Session, Superseded
from tiler.explore.tile_queue import FATES
from tiler.heatmaps import overdraw_map
from tiler.scene.camera import camera_at, eye_and_target
from tiler.tally import TILE_COUNTERS

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")

SIZE = (96, 64)
FIRST = {"page": "a"}
PATIENCE = 600.0  # seconds, where kernels must be compiled first


@pytest.fixture(scope="module")
def scene(load):
    return load("waves", size=SIZE, factor=3)


@pytest.fixture(scope="module")
def session(scene) -> Iterator[Session]:
    made = Session(scene, tiler.Machine(tile=16), threads=2)
    yield made
    assert made.close(10.0)


@pytest.fixture(scope="module")
def explorer(scene) -> Iterator[Explorer]:
    made = Explorer(scene, tiler.Machine(tile=16), threads=2)
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join(10.0)
    assert not thread.is_alive() and made.close()


def ask(
    explorer: Explorer, body: Any, method: str = "POST", path: str = "/view", **headers: str
) -> tuple[int, bytes, Any]:
    """Status, content and headers; a header given as "" is left out."""
    connection = http.client.HTTPConnection("127.0.0.1", explorer.port, timeout=PATIENCE)
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    usual = {"Host": f"127.0.0.1:{explorer.port}", "Content-Type": "application/json", "X-Tiler-Token": explorer.token}
    connection.putrequest(method, path, skip_host=True)
    for name, value in (usual | {name.replace("_", "-"): value for name, value in headers.items()}).items():
        if value:
            connection.putheader(name, value)
    connection.putheader("Content-Length", str(len(content)))
    connection.endheaders(content)
    answer = connection.getresponse()
    found = answer.status, answer.read(), answer.headers
    connection.close()
    return found


def unpack(reply: bytes) -> tuple[dict[str, Any], Any]:
    """The JSON of a reply, and a function that reads an array of it."""
    end = 4 + int.from_bytes(reply[:4], "little")
    assert end % 8 == 0, "arrays are aligned"

    def array(place: dict[str, Any]) -> np.ndarray:
        kind = {"u8": np.uint8, "i32": np.dtype("<i4"), "f64": np.dtype("<f8")}[place["type"]]
        return np.frombuffer(reply, kind, place["length"], end + place["at"])

    return json.loads(reply[4:end]), array


def test_a_view_holds_what_was_simulated(explorer, scene):
    status, reply, headers = ask(
        explorer, FIRST | {"map": "overdraw", "point": [0.5, 0.6], "patches": [5], "bounds": ["tpatch"]}
    )
    assert status == 200 and headers["cache-control"] == "no-store" and "access-control-allow-origin" not in headers
    view, array = unpack(reply)
    frame = tiler.simulate(scene, tiler.Machine(tile=16))
    assert view["counters"] == list(frame.counters.values())
    assert np.array_equal(array(view["picture"]).reshape(64, 96, 4), frame.color)
    assert np.array_equal(array(view["maps"]["queue_entries"]).reshape(4, 6), frame.queues.entries)
    assert np.array_equal(array(view["maps"]["overdraw"]).reshape(64, 96), overdraw_map(scene, frame.machine))
    under = array(view["under"]).reshape(64, 96)
    assert ((under >= 0) == (frame.depth < 1)).all() and under.max() < scene.num_patches
    assert [view["queue"]["column"], view["queue"]["row"]] == [3, 2]
    assert sum(view["queue"]["entries"]) == frame.queues.entries[2, 3] == len(view["queue"]["fate"])
    assert [(box["bound"], box["own"]) for box in view["boxes"]] == [("cbox", True), ("tpatch", False)]


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"X_Tiler_Token": ""}, 403), ({"X_Tiler_Token": "x" * 32}, 403), ({"X_Tiler_Token": "ü"}, 403),
        ({"Host": "evil.example"}, 400), ({"Host": "127.0.0.1"}, 400), ({"Host": "127.0.0.1:1"}, 400), ({"Host": ""}, 400),
        ({"Origin": "http://evil.example"}, 403), ({"Origin": "null"}, 403), ({"Sec_Fetch_Site": "cross-site"}, 403),
        ({"Sec_Fetch_Site": "same-site"}, 403), ({"Content_Type": "text/plain"}, 415), ({"Content_Type": ""}, 415),
    ],
)  # fmt: skip
def test_strangers_are_refused(explorer, change, status):
    assert ask(explorer, FIRST, **change)[0] == status


def test_who_belongs_here_is_let_in(explorer):
    own = f"localhost:{explorer.port}"
    assert ask(explorer, FIRST, Host=own, Origin=f"http://{own}", Sec_Fetch_Site="same-origin")[0] == 200


def test_the_page_needs_the_token_and_asks_nobody_else(explorer):
    for path in ("/", "/?token=", f"/?token={explorer.token}x", "/favicon.ico"):
        assert ask(explorer, b"", "GET", path, X_Tiler_Token="")[0] == 403
    status, page, headers = ask(explorer, b"", "GET", explorer.url.partition(str(explorer.port))[2], X_Tiler_Token="")
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert headers["referrer-policy"] == "no-referrer" and headers["x-frame-options"] == "DENY"
    text = page.decode()
    assert explorer.token not in text and "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert len(explorer.token) >= 32 and explorer.url.startswith("http://127.0.0.1:")


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (b"", "request"), (b"{", "request"), (b"[]", "request"), ({}, "page"), (FIRST | {"page": "A b"}, "page"),
        (FIRST | {"frame": -1}, "frame"), (FIRST | {"frame": "1"}, "frame"), (b'{"page": "a", "frame": NaN}', "frame"),
        (FIRST | {"camera": {"eye": [0, 0, 0], "target": [0, 0, 0]}}, "camera"),
        (FIRST | {"camera": {"eye": [0, 0], "target": [0, 0, 0]}}, "camera.eye"),
        (FIRST | {"camera": {"eye": [1e99, 0, 0], "target": [0, 0, 0]}}, "camera.eye"),
        (FIRST | {"machine": {"tile": 7}}, "machine.tile"), (FIRST | {"machine": {"tiles": 8}}, "did you mean 'tile'"),
        (FIRST | {"machine": {"self": 1}}, "machine.self"), (FIRST | {"machine": {"tile": {}}}, "machine.tile"),
        (FIRST | {"machine": {"bounds": ["cbox"]}}, "machine.bounds"), (FIRST | {"machine": {"cull": ["frustrum"]}}, "frustum"),
        (FIRST | {"machine": {"queue_model": "/etc/x.toml"}}, "machine.queue_model"),
        (FIRST | {"machine": {"binning": "triangle", "queue_order": "front_to_back"}}, "queue_order"),
        (FIRST | {"scene": {"factor": 65}}, "scene.factor"), (FIRST | {"scene": {"size": [1, 1]}}, "scene.size"),
        (FIRST | {"map": "overdrawn"}, "did you mean 'overdraw'"), (FIRST | {"point": [0.5, 1.5]}, "point"),
        (FIRST | {"patches": [1024]}, "patches"), (FIRST | {"patches": [-1]}, "patches"), (FIRST | {"bounds": ["x"]}, "bounds"),
    ],
)  # fmt: skip
def test_bad_requests_are_told_in_a_line_each(explorer, body, told):
    status, content, _ = ask(explorer, body)
    error = json.loads(content)["error"]
    assert status == 422 and told in error and "Traceback" not in error and len(error) < 2000


def test_other_ways_of_asking_are_refused(explorer):
    assert ask(explorer, b" " * 70_000)[0] == 413
    assert ask(explorer, b"", "GET", "/view")[0] == 405
    assert ask(explorer, FIRST, path="/other")[0] == 404


def test_a_fault_of_ours_is_told_and_the_server_goes_on(explorer, monkeypatch, capsys):
    def broken(*arguments: object, **more: object) -> None:
        raise KeyError("inside")

    with monkeypatch.context() as patch:
        patch.setattr(session_module, "render_frame", broken)
        status, content, _ = ask(explorer, FIRST | {"machine": {"tile": 128}})
    assert status == 500 and "KeyError: 'inside'" in json.loads(content)["error"]
    assert "Traceback" not in capsys.readouterr().err
    assert ask(explorer, FIRST)[0] == 200


def test_the_newest_request_of_a_page_wins(session, monkeypatch):
    """The first is running, the second waits: both end when the third comes; another page's request is kept."""
    begun, go_on = threading.Event(), threading.Event()
    render = session_module.render_frame

    def slow(*arguments, **more):
        begun.set()
        assert go_on.wait(PATIENCE)
        return render(*arguments, **more)

    monkeypatch.setattr(session_module, "render_frame", slow)
    first = session.submit(Ask(page="a", frame=2))
    assert begun.wait(PATIENCE)
    second, other = session.submit(Ask(page="a", frame=3)), session.submit(Ask(page="b", frame=4))
    third = session.submit(Ask(page="a", frame=5))
    for dropped in (first, second):
        with pytest.raises(Superseded):
            dropped.done.result(0.0)
    go_on.set()
    assert [other.done.result(PATIENCE).frame.number, third.done.result(PATIENCE).frame.number] == [4, 5]
    gone = session.submit(Ask(page="c", frame=6))
    session.cancel(gone)
    with pytest.raises(Superseded):
        gone.done.result(PATIENCE)


def test_the_same_frame_is_not_drawn_again(session):
    first = session.submit(Ask(page="a")).done.result(PATIENCE)
    other = session.submit(Ask(page="a", map="overdraw", patches=[3])).done.result(PATIENCE)
    assert other.frame is first.frame and len(other.boxes) == 1
    looked = session.submit(Ask(page="a", point=(0.5, 0.5))).done.result(PATIENCE)
    assert looked.queue is not None
    assert (
        session.submit(Ask(page="a", point=(0.5, 0.5), map="queue_bytes")).done.result(PATIENCE).queue is looked.queue
    )


def test_a_browser_that_goes_away_does_no_harm(explorer):
    connection = http.client.HTTPConnection("127.0.0.1", explorer.port, timeout=20)
    headers = {"Content-Type": "application/json", "X-Tiler-Token": explorer.token}
    connection.request("POST", "/view", json.dumps(FIRST | {"frame": 9}), headers)
    connection.close()
    assert ask(explorer, {"page": "b"})[0] == 200


MACHINES: dict[str, dict[str, Any]] = {
    "patch": {},
    "triangle": {"binning": "triangle", "cull": ["frustum", "occlusion"]},
    "all tests": {"cull": ["occlusion", "occlusion:triangle", "occlusion:block"], "queue_order": "front_to_back"},
    "two phases": {"cull": ["occlusion"], "z_feedback": "two_phase", "domain_cache": "frame"},
    "last frame": {"binning": "subpatch", "subpatch_budget": 2, "cull": ["occlusion"], "z_feedback": "previous_frame"},
    "small cache": {"binning": "subpatch", "subpatch_budget": 2, "domain_cache": "lru:4", "coarse_z_update": "feed_forward"},
    "flushes": {"queue_pool": 600, "queue_policy": "flush"},
}  # fmt: skip


@pytest.mark.parametrize("most", [1000, 7])
@pytest.mark.parametrize("name", MACHINES)
def test_the_entries_of_a_tile_add_up_to_its_counters(session, monkeypatch, name, most):
    monkeypatch.setattr(tile_queue, "MOST_ENTRIES", most)
    looked = Ask(
        page="a", frame=1, machine=MACHINES[name], point=(0.45, 0.4), scene={"samples": 4 if name == "patch" else 1}
    )
    session._kept.clear()
    view = session.submit(looked).done.result(PATIENCE)
    queue, frame = view.queue, view.frame
    row, column = divmod(view.tile, frame.queues.entries.shape[1])
    told = {counter: int(queue.column(code).sum()) for counter, code in TILE_COUNTERS.items()}
    assert told == {counter: int(values[row, column]) for counter, values in frame.tiles.items()}
    assert len(queue.fate) == min(told["queue_entries"], most + 1) == len(queue.unit) == len(queue.visible)
    assert (
        queue.visible.sum() == (frame.depth_samples[16 * row : 16 * row + 16, 16 * column : 16 * column + 16] < 1).sum()
    )
    assert (queue.visible <= queue.column(TILE_COUNTERS["om_samples_passed"])).all()
    assert set(queue.fate) <= set(FATES) and (queue.fate[-1] == "rest") == (told["queue_entries"] > most)
    if most == 1000 and name in ("all tests", "two phases"):
        assert queue.fate.count("occluded") == told["cz_pairs_occluded"]
    seen = set(np.unique(view.under[16 * row : 16 * row + 16, 16 * column : 16 * column + 16])) - {-1}
    if most == 1000 and name != "patch":
        assert {p for p, fate in zip(queue.patch, queue.fate, strict=True) if fate == "visible"} == seen


def test_an_empty_tile_and_a_scene_with_no_patch():
    empty = Session(patch_scene([]), tiler.Machine(), threads=1)
    view = empty.submit(Ask(page="a", point=(1.0, 1.0))).done.result(PATIENCE)
    assert view.queue.fate == [] and view.under.max() == -1
    with pytest.raises(TilerError, match="patches: 0"):
        empty.submit(Ask(page="a", patches=[0]))
    assert empty.close(10.0)
    with pytest.raises(TilerError, match="closed"):
        empty.submit(Ask(page="a"))


def test_boxes_are_the_bounds(session, scene):
    """Every end of a line is a corner of the box by the bound of all patches, projected in plain loops."""
    names = ["cbox", "tpatch", "obbtex"]
    view = session.submit(Ask(page="a", patches=[500, 620], bounds=names)).done.result(PATIENCE)
    assert len(view.boxes) == 2 * len(names)
    stage = hull_stage(scene, 0)
    for box in view.boxes:
        bounds = BOUNDS[box.bound](stage)
        corners = [0.5 + 0.5 * c[:2] * (1, -1) / c[3] for c in bounds.corners[box.patch]]
        assert box.lines.shape == (12, 4), "the box is before the eye"
        for (a, b), line in zip(EDGES, box.lines, strict=True):
            assert line == pytest.approx([*corners[a], *corners[b]], abs=1e-9)
        x0, y0, x1, y1 = bounds.rect[box.patch]
        assert box.rect == (x0, y0, x1, y1) and box.z_min == bounds.z_min[box.patch]
        inside = (box.lines.reshape(-1, 2).clip(0, 1) * SIZE + 0.5).astype(int)
        assert (inside >= (x0 - 1, y0 - 1)).all() and (inside <= (x1 + 1, y1 + 1)).all()
    axes = [
        {tuple(np.sign(corners[b] - corners[a]).astype(int)) for a, b in EDGES[4 * k : 4 * k + 4]} for k in range(3)
    ]
    assert all(len(found) <= 2 for found in axes), "four edges of an axis run the same way, but for perspective"


def test_boxes_of_sub_domains(session):
    cut = {"binning": "subpatch", "subpatch_extent": 4}
    view = session.submit(Ask(page="a", patches=[620], machine=cut)).done.result(PATIENCE)
    assert [box.part for box in view.boxes[:2]] == [-1, 0] and len(view.boxes) > 2


def test_lines_are_cut_at_the_near_plane_and_far_off_the_picture():
    cube = np.array([[k & 1, k >> 1 & 1, 0, 1] for k in range(8)], float) - [0.5, 0.5, 0, 0]
    cube[:, 3] += np.arange(8) >> 2
    cube[:, 2] = cube[:, 3] - 1.0
    assert len(box_lines(cube)) == 12
    behind = cube - [0, 0, 0.5, 0.5]  # the near face lies before the near plane
    lines = box_lines(behind)
    assert len(lines) == 8 and np.isfinite(lines).all()
    assert len(box_lines(cube - [0, 0, 5, 5])) == 0
    wide = cube * [1e9, 1e9, 1, 1]
    assert abs(box_lines(wide) - 0.5).max(initial=0) <= 0.5 * REACH + 1e-9
    cube[3] = np.nan
    assert len(box_lines(cube)) == 9


def test_the_camera_goes_where_it_is_asked(scene):
    eye, target = eye_and_target(scene.camera, 0)
    stays = change_scene(scene, read_ask(json.dumps(FIRST | {"camera": {"eye": eye, "target": target}}).encode()))
    before, after = camera_at(scene.camera, 0, 1.5), camera_at(stays.camera, 7, 1.5)
    assert np.array_equal(before.clip_from_world, after.clip_from_world)
    away = [t + 3 * (e - t) for e, t in zip(eye, target, strict=True)]
    moved = change_scene(
        scene, read_ask(json.dumps(FIRST | {"camera": {"eye": away, "target": target}}).encode())
    ).camera
    assert moved.near == scene.camera.near and moved.far > scene.camera.far and moved.keys[0].eye == tuple(away)


def test_drafts_are_small_and_of_the_same_shape(scene):
    assert (
        draft_size(1920, 1080) == (320, 180)
        and draft_size(640, 360) == (320, 180)
        and draft_size(200, 100) == (200, 100)
    )
    assert draft_size(16384, 1) == (16384, 1) and min(draft_size(1, 16384)) == 1
    big = replace(scene, picture=replace(scene.picture, width=640, height=360))
    drawn = change_scene(big, Ask(page="a", full=False, scene={"factor": 5, "shading": "patch", "samples": 4}))
    assert (drawn.picture.width, drawn.picture.height, drawn.picture.samples) == (320, 180, 4)
    assert drawn.tessellation.factor == (5.0,) * 6 and drawn.picture.shading == "patch"
    edges = replace(scene, tessellation=replace(scene.tessellation, edge_pixels=9.0))
    assert change_scene(edges, Ask(page="a")).tessellation.edge_pixels == 9.0
    assert not make_machine(Ask(page="a", full=False), tiler.Machine(blame=True, verify=True)).blame


def test_forms_offer_what_the_machine_allows():
    form = {field["name"]: field for field in machine_form(tiler.Machine())}
    assert list(form) == list(tiler.Machine.model_fields)
    assert form["tile"]["choices"] == list(TILE_SIZES) and form["bounds"]["choices"] == list(BOUNDS)
    assert form["queue_policy"]["none"] and form["queue_pool"]["kind"] == "number" and form["verify"]["kind"] == "tick"
    assert set(field_texts()) == set(tiler.Machine.model_fields), "each field has its text"
    for fields in presets(tiler.Machine(tile=64)).values():
        tiler.Machine(**fields)
    for field in form.values():
        for value in field.get("choices", []) if field["kind"] == "choice" else []:
            tiler.Machine(**{"tile": 64, "cull": ["frustum"], field["name"]: value})


def test_a_busy_port_is_one_clear_error(explorer, capsys):
    with pytest.raises(TilerError, match=f"port: {explorer.port} is in use; allowed"):
        listen(explorer.port)
    with pytest.raises(TilerError, match="port: 70000 is not allowed"):
        listen(70000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["tiler", "explore", "teapot", "--port", str(explorer.port), "--no-browser"])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert ended.value.code == 2
    assert f"error: port: {explorer.port} is in use" in capsys.readouterr().err


def test_without_its_libraries_the_extra_is_named(monkeypatch, scene):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(
        TilerError, match=r"uvicorn is not installed; allowed: after `pip install 'tilesim\[explore\]'`"
    ):
        Explorer(scene)


@pytest.mark.parametrize("when", ["idle", "drawing", "compiling"])
def test_ctrl_c_ends_it_at_once(when, tmp_path):
    # An empty folder for the kernels: the first view compiles. In the folder of all tests another one may or may not have.
    environment = os.environ | ({"TILER_CACHE_DIR": str(tmp_path)} if when == "compiling" else {})
    process = subprocess.Popen(
        [sys.executable, "-m", "tiler", "explore", "teapot", "--size", "64x48", "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip
    try:
        address = process.stdout.readline().split(": ", 1)[1].strip()
        port, token = int(address.split(":")[2].split("/")[0]), address.split("=")[1]
        until = time.monotonic() + 30
        while time.monotonic() < until:
            try:
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
                connection.request("GET", f"/?token={token}")
                assert connection.getresponse().status == 200
                break
            except ConnectionError:
                time.sleep(0.05)
        if when != "idle":
            connection.close()
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
            large = {"page": "a", "scene": {"factor": 64, "samples": 4}, "machine": {"tile": 8, "verify": True}}
            headers = {"Content-Type": "application/json", "X-Tiler-Token": token}
            connection.request("POST", "/view", json.dumps(large), headers)
            time.sleep(0.3 if when == "drawing" else 2.0)
        begin = time.monotonic()
        process.send_signal(2)
        out, err = process.communicate(timeout=20)
        took = time.monotonic() - begin
    finally:
        process.kill()
    said = err.splitlines()
    assert process.returncode == 0 and said.pop() == "ended" and "Traceback" not in out
    announced = ["compiling kernels, first run only ..."]
    assert said == announced if when == "compiling" else said in ([], announced)
    assert took < 2.0, "the first signal is enough"
    with socket.socket() as again:
        assert again.connect_ex(("127.0.0.1", port)) != 0, "nobody listens any more"


def test_the_page_of_the_docs_tells_every_fate():
    text = (Path(__file__).resolve().parent.parent / "docs" / "explorer.md").read_text()
    assert not [fate.title for name, fate in FATES.items() if name != "rest" and fate.title not in text]
