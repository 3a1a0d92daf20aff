"""Help that teaches, names that are guessed, JSON everywhere, completion: the command line as a whole."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import TESTS
from tests.test_cli import tiler as run_tiler
from tiler.cli import app

COMMANDS = {name: app[name] for name in app if not name.startswith("-")}
FUNCTIONS = {name: command.default_command for name, command in COMMANDS.items()}
PAGE = (TESTS.parent / "docs" / "command-line.md").read_text()


def examples() -> list[str]:
    found = []
    for function in FUNCTIONS.values():
        (paragraph,) = re.findall(r"Examples?:(.*?)\n\s*\n", function.__doc__ + "\n\n", re.S)
        found += re.findall(r"`tiler\s+([^`]*)`", paragraph)
    found += re.findall(r"^tiler (.*?)(?:  +#.*)?$", PAGE, re.M)
    return [" ".join(text.split()) for text in found]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_an_example_of_the_command_itself(name):
    text = FUNCTIONS[name].__doc__
    assert re.search(r"Examples?: `tiler " + name, text), name


@pytest.mark.parametrize("text", examples())
def test_examples_are_understood(text):
    """Every example of the help and of the page names commands and options that there are, with values of their types."""
    words = shlex.split(text.partition(" > ")[0])
    assert words[0] in COMMANDS or words[0] in ("--help", "--install-completion", "--version")
    if words[0] in COMMANDS:
        command, _, ignored = app.parse_args(words, exit_on_error=False, print_error=False)
        assert command is FUNCTIONS[words[0]] and not ignored
    elif words[0] == "--install-completion":
        assert "--install-completion" in set(app)


NO_NUMBERS = {"completion", "explore"}  # a script, and a page


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - NO_NUMBERS))
def test_every_command_takes_json(name):
    assert "json" in FUNCTIONS[name].__annotations__


def test_help_says_how_the_command_ends(tmp_path):
    done = run_tiler("--help", cwd=tmp_path)
    told = " ".join(done.stdout.split())
    for status in ("0 fine", "1 a check failed", "2 bad input", "130 interrupted", "141 standard output was closed"):
        number, _, meaning = status.partition(" ")
        assert status in told and f"| {number} | {meaning}" in PAGE
    assert all(f" {name} " in told for name in COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rendr", "teapot"], '"render"'),
        (["render", "teapt"], "'teapot'"),
        (["render", "teapot", "--bound", "cbox"], "--bounds"),
        (["render", "teapot", "--bounds", "tpach"], "'tpatch'"),
        (["render", "teapot", "--cull", "frustm"], "'frustum'"),
        (["render", "teapot", "--binning", "pach"], '"patch"'),
        (["render", "teapot", "--queue-model", "block64"], "'blocks64'"),
        (["render", "teapot", "--heatmap", "queue_entrys"], "'queue_entries'"),
        (["render", "teapot", "--trace", "t.json", "--trace-model", "wid"], "'wide'"),
        (["render", "teapot", "--machine-preset", "malilike"], "'mali-like'"),
        (["compare", "teapot", "--machine", "bining=patch"], "'binning'"),
        (["compare", "teapot", "--cost", "munkberg"], "'munkberg2010'"),
        (["export", "teapot", "--bounds", "npach"], "'npatch'"),
        (["validate", "bonds"], '"bounds"'),
        (["reproduce", "munkberg201"], "'munkberg2010'"),
        (["counters", "--jsn", "-"], "--json"),
        (["machines", "openswr"], "'openswr-like'"),
        (["completion", "bas"], '"bash"'),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_a_name_that_is_nearly_right_is_guessed(arguments, meant, tmp_path, monkeypatch, capsys):
    from tiler import cli

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "argv", ["tiler", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    told = " ".join(capsys.readouterr().err.split())
    assert end.value.code == 2
    assert re.search("did you mean " + re.escape(meant), told, re.I), told
    assert "Traceback" not in told and not list(tmp_path.iterdir())


def test_doctor_as_json(tmp_path):
    done = run_tiler("doctor", "--json", "-", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert done.returncode == bool(found["problems"])
    assert found["versions"]["numba"] and "teapot" in found["scenes"] and found["threads"] >= 1
    plain = run_tiler("doctor", cwd=tmp_path)
    assert found["versions"]["numba"] in plain.stdout and plain.returncode == done.returncode


def test_warmup_as_json(monkeypatch, capsys):
    from tiler import warmup as module
    from tiler.commands.upkeep import warmup

    monkeypatch.setattr(module, "warm_up", lambda: None)
    warmup(json="-")
    assert json.loads(capsys.readouterr().out)["seconds"] >= 0
    warmup()
    assert "kernels are ready" in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_options(shell, tmp_path):
    done = run_tiler("completion", shell, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in COMMANDS) and "machine-preset" in done.stdout
    if shell == "bash":
        (tmp_path / "c").write_text(done.stdout)
        asked = f"source {tmp_path}/c; COMP_WORDS=(tiler rend); COMP_CWORD=1; _tiler; echo ${{COMPREPLY[@]}}"
        assert subprocess.check_output(["bash", "-c", asked], text=True).strip() == "render"


def test_completion_is_installed_in_the_users_own_folder(tmp_path):
    (tmp_path / ".bashrc").write_text("# mine\n")
    done = subprocess.run(
        [sys.executable, "-m", "tiler", "--install-completion"], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        env=os.environ | {"HOME": str(tmp_path), "SHELL": "/bin/bash", "PYTHONPATH": str(TESTS.parent)}, check=False,
    )  # fmt: skip
    files = [file for file in Path(tmp_path).rglob("*") if file.is_file()]
    assert done.returncode == 0, done.stdout + done.stderr
    assert any("_tiler" in file.read_text() for file in files)


def test_the_machine_on_the_page_is_one(tmp_path):
    import tiler

    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
    (tmp_path / "mine.toml").write_text(text)
    machine = tiler.load_machine(tmp_path / "mine.toml")
    assert (machine.binning, machine.bounds, machine.queue_model) == ("patch", "tpatch", "hierarchy16")
