"""Machines as data: the shipped ones, files of the user's own, what is told of a wrong one, and the command's options."""

import json
from pathlib import Path

import pytest

import tiler
from tests.test_cli import SMALL
from tests.test_cli import tiler as run_tiler
from tiler.commands.compare import chosen_machines
from tiler.commands.listings import machines
from tiler.comparison import MACHINES
from tiler.config import Machine
from tiler.errors import TilerError
from tiler.options import MachineOptions, make_machine, parse_machine
from tiler.presets import load_machine, load_preset, machine_toml, preset_names

COMPARED = {
    "triangle": "triangle", "patch": "patch", "patch, frame cache": "patch-cached", "patch, all": "patch-all",
    "subpatch, all": "subpatch-all",
}  # fmt: skip


def test_shipped_machines_load_and_say_where_they_are_from():
    assert {"default", "openswr-like", "llvmpipe-like", "cudaraster-like", "mali-like"} <= set(preset_names())
    for name in preset_names():
        preset = load_preset(name)
        assert preset.machine() == load_machine(name) and preset.title and preset.source
    assert load_machine("default") == Machine()
    assert load_machine("mali-like").tile == 16 and load_machine("mali-like", tile=32).tile == 32
    peers = [load_machine(name) for name in preset_names() if name.endswith("-like")]
    assert {(m.tile, m.queue_model) for m in peers} == {
        (32, "blocks64"), (64, "blocks29"), (8, "bins128"), (16, "hierarchy16"),
    }  # fmt: skip
    assert {m.binning for m in peers} == {"triangle"}  # nobody bins patches


def test_machines_that_are_compared_are_presets_too():
    assert set(COMPARED) == set(MACHINES)
    for name, preset in COMPARED.items():
        assert Machine(**MACHINES[name]) == load_machine(preset)


@pytest.mark.parametrize("name", ["cudaraster-like", "llvmpipe-like", "mali-like", "openswr-like"])
def test_peers_draw_the_same_picture(load, name):
    scene = load("teapot", size=(64, 40), factor=2)
    frames = [tiler.simulate(scene, machine, threads=1) for machine in (Machine(), load_machine(name))]
    assert (frames[0].color == frames[1].color).all() and (frames[0].depth == frames[1].depth).all()


@pytest.mark.parametrize("name", preset_names())
def test_a_written_machine_is_read_again(name, tmp_path):
    file = tmp_path / "m.toml"
    preset = load_preset(name)
    file.write_text(machine_toml(preset.machine(), 'a "title" \\ more', preset.source))
    assert load_machine(file) == preset.machine()
    assert load_preset(str(file)).title == 'a "title" \\ more'
    assert all(field in file.read_text() for field in Machine.model_fields)


def write(folder: Path, name: str, text: str) -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def test_files_extend_machines(tmp_path):
    write(
        tmp_path,
        "base.toml",
        'extends = "mali-like"\nbinning = "patch"\ncull = "frustum+occlusion"\nz_feedback = "tile"\n',
    )
    top = write(tmp_path, "top.toml", 'title = "mine"\nextends = "base.toml"\ntile = 32\nqueue_pool = 4000000\n')
    machine = load_machine(top)
    assert (machine.tile, machine.binning, machine.queue_model) == (32, "patch", "hierarchy16")
    assert machine.cull == ("frustum", "occlusion") and machine.queue_pool == 4000000
    none = write(tmp_path, "none.toml", 'extends = "top.toml"\ncull = "none"\n')
    assert load_machine(none).cull == ()


def test_a_queue_model_lies_beside_its_machine(tmp_path):
    from tiler.data_files import FOLDER

    write(tmp_path, "q.toml", (FOLDER / "queue_models" / "blocks64.toml").read_text())
    file = write(tmp_path, "m.toml", 'queue_model = "q.toml"\n')
    assert load_machine(file).queue_model == str(tmp_path / "q.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('title = "x"\ntiel = 16\n', r"m.toml:2: tiel: unknown key; did you mean 'tile'\? allowed: tile, binning"),
        ('tile = 16\nbounds = "tpach"\n', r"m.toml:2: bounds: 'tpach'; did you mean 'tpatch'"),
        ('binning = "pach"\n', r"m.toml:1: binning: 'pach' is not allowed; allowed: 'triangle', 'patch' or 'subpatch'"),
        ("tile = 17\n", r"m.toml:1: tile: 17; allowed: a power of two, 8, 16"),
        ('tile = "16"\n', r"m.toml:1: tile: '16' is not allowed; .*integer"),
        ('tile = 16\nbad = 1\ncores = 0\n', r"(?s)m.toml:3: cores: 0; allowed: 1 to 65536.*m.toml:2: bad: unknown key"),
        ('cull = ["frustum", "oclusion"]\n', r"m.toml:1: cull: .*did you mean 'occlusion'"),
        ('extends = "triangle"\nqueue_order = "front_to_back"\n', r"m.toml:2: queue_order: 'front_to_back'; allowed with"),
        ('queue_order = "front_to_back"\nextends = "triangl"\n', r"m.toml:2: extends: 'triangl' is unknown; did you mean 'tri"),
        ('extends = "m.toml"\n', r"m.toml:1: extends: 'm.toml' extends this file"),
        ('extends = "other.toml"\n', r"other.toml: cannot be read \(No such file"),
        ("title = 3\n", r"m.toml:1: title: 3 is not allowed; allowed: a text"),
        ("tile = \n", r"m.toml: is not a TOML file"),
        ("[tile]\nx = 1\n", r"m.toml:1: tile: .* is not allowed"),
    ],
)  # fmt: skip
def test_what_is_told_of_a_wrong_file(tmp_path, text, words):
    with pytest.raises(TilerError, match=words):
        load_machine(write(tmp_path, "m.toml", text))


def test_circles_and_unknown_names_are_told(tmp_path):
    write(tmp_path, "a.toml", 'extends = "b.toml"\n')
    with pytest.raises(TilerError, match=r"a.toml:1: extends: 'b.toml' extends this file"):
        load_machine(write(tmp_path, "b.toml", 'tile = 8\nextends = "a.toml"\n'))
    with pytest.raises(TilerError, match=r"machine: 'maly-like' is unknown; did you mean 'mali-like'\? allowed: "):
        load_machine("maly-like")


# Options.


def test_options_change_the_machine_that_they_start_from(tmp_path):
    options = MachineOptions(machine_preset="llvmpipe-like", tile=32)
    assert make_machine(options) == load_machine("llvmpipe-like", tile=32)
    file = write(tmp_path, "m.toml", "cores = 7\n")
    assert make_machine(MachineOptions(machine_file=Path(file), cull="none")) == Machine(cores=7, cull=())
    with pytest.raises(TilerError, match="stands beside preset 'patch'; allowed: one of the two"):
        make_machine(MachineOptions(machine_preset="patch", machine_file=Path(file)))


def test_machines_as_text_start_from_presets(tmp_path):
    mali = MachineOptions(machine_preset="mali-like")
    assert parse_machine("preset=mali-like,tile=32", MachineOptions()) == load_machine("mali-like", tile=32)
    assert parse_machine("tile=32", mali) == load_machine("mali-like", tile=32)
    assert parse_machine("preset=openswr-like,cull=frustum", mali) == load_machine("openswr-like", cull=("frustum",))
    assert parse_machine("preset=default,tile=16", mali) == Machine(tile=16)
    file = write(tmp_path, "m.toml", "cores = 7\n")
    assert parse_machine(f"file={file},tile=16", mali) == Machine(cores=7, tile=16)
    with pytest.raises(TilerError, match="did you mean 'mali-like'"):
        parse_machine("preset=mali", MachineOptions())


def test_render_takes_a_preset(tmp_path):
    done = run_tiler(
        "render", "teapot", *SMALL, "--machine-preset", "mali-like", "--cores", "2", "--json", "-", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["machine"] == load_machine("mali-like", cores=2).model_dump(mode="json")


def test_machines_that_are_compared():
    text = "preset=mali-like,tile=32"
    assert chosen_machines(("preset=triangle", text), MachineOptions()) == {
        "preset=triangle": load_machine("triangle"), text: load_machine("mali-like", tile=32),
    }  # fmt: skip
    assert chosen_machines((), MachineOptions(machine_preset="patch-all", cores=2)) == {
        "triangle": load_machine("triangle", cores=2), "patch-all": load_machine("patch-all", cores=2),
    }  # fmt: skip
    assert list(chosen_machines((), MachineOptions())) == list(MACHINES)


def test_machines_are_listed_and_printed(tmp_path, capsys):
    def printed(*arguments: object, **options: object) -> str:
        machines(*arguments, **options)
        return capsys.readouterr().out

    found = {machine["name"]: machine for machine in json.loads(printed(json="-"))["machines"]}
    assert list(found) == list(preset_names())
    one = json.loads(printed("mali-like", json="-"))
    assert one == found["mali-like"] and one["machine"] == load_machine("mali-like").model_dump(mode="json")
    assert [line.split()[0] for line in printed().splitlines()] == list(preset_names())
    shown = printed("mali-like")
    assert "hierarchy16" in shown and "domain_cache" not in shown and "source: Mesa's panfrost" in shown
    mine = write(tmp_path, "mine.toml", printed("mali-like", toml=True))
    assert load_machine(mine) == load_machine("mali-like") and "hierarchy16" in printed(mine)
    with pytest.raises(TilerError, match="name: missing with --toml; allowed: cudaraster-like"):
        machines(toml=True)
