"""The edge of the three commands: the version, and what it costs to ask for it; how wide their lines are."""

import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from huesphere.configs.commandline import Parser, installed_version, say_wrapped

ROOT = Path(__file__).parent.parent
COMMANDS = {"render": "render.cli", "recover": "recover.cli", "evaluate": "eval.cli"}


@pytest.mark.parametrize("command", COMMANDS)
def test_version_is_that_of_the_project_and_loads_no_library(command, tmp_path):
    code = (
        f"import sys; sys.argv = ['{command}', '--version']\n"
        "heavy = {'numpy', 'scipy', 'numba', 'mitsuba', 'pydantic', 'matplotlib'}\n"
        f"from huesphere.{COMMANDS[command]} import main\n"
        "try: main()\n"
        "except SystemExit as end: print(end.code, sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert done.stdout.splitlines() == [f"huesphere {project['version']}", "0 []"], done.stderr


def test_version_is_given_without_the_arguments_that_the_command_requires(capsys):
    parser = Parser(prog="x")
    parser.add_argument("source")
    with pytest.raises(SystemExit) as end:
        parser.parse_args(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("huesphere ")


def test_without_installation_the_version_is_said_to_be_unknown(monkeypatch):
    def missing(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    assert installed_version() == "(version unknown: huesphere is not installed as a package)"


def test_lines_are_wrapped_at_80_characters_and_paths_stay_whole(capsys):
    path = "/".join(["a-folder"] * 12)
    say_wrapped(f"picture  auto  ok\n    doubt: {'more words ' * 20}\n\nwritten: {path}, page: {path}/report.html")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "picture  auto  ok"
    assert lines[1].startswith("    doubt: more")
    assert all(line.startswith("        ") for line in lines[2:4])
    assert [line for line in lines if len(line) > 80] == [f"    {path},", f"    {path}/report.html"]
    assert "" in lines
