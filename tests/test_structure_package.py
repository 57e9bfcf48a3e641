"""The package that is given away: sdist and wheel build, hold what they need, and work in a clean environment.

The clean environment borrows the libraries of this one; of huesphere it has nothing but the wheel.
"""

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
BUILD = "import setuptools.build_meta as b, sys; print(getattr(b, sys.argv[1])(sys.argv[2]))"


def run(*command, cwd, **environment) -> str:
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(c) for c in command], cwd=cwd, capture_output=True, text=True, timeout=600, env=kept | environment
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """(sdist, wheel); the wheel is built from what the sdist holds and nothing else."""
    folder = tmp_path_factory.mktemp("built")
    tools = folder / "tools"
    asked = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--target", tools, "setuptools>=77"], capture_output=True
    )
    if asked.returncode:
        pytest.skip("no setuptools to be had")
    source = folder / "source"
    names = run("git", "ls-files", "--cached", "--others", "--exclude-standard", cwd=ROOT).split("\n")
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    tool = {"PYTHONPATH": str(tools)}
    sdist = folder / run(sys.executable, "-c", BUILD, "build_sdist", folder, cwd=source, **tool).split("\n")[-2]
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    wheel = folder / run(sys.executable, "-c", BUILD, "build_wheel", folder, cwd=unpacked, **tool).split("\n")[-2]
    return sdist, wheel


def test_the_wheel_holds_every_module_and_the_data(built):
    with zipfile.ZipFile(built[1]) as wheel:
        inside = set(wheel.namelist())
    for package in ("configs", "scenes", "render", "recover", "eval"):
        for path in (ROOT / package).rglob("*"):
            if path.suffix in (".py", ".yaml", ".j2", ".js", ".css", ".html"):
                assert path.relative_to(ROOT).as_posix() in inside
    assert not [name for name in inside if name.startswith(("tests", "benchmarks", "docs"))]


def test_the_wheel_works_in_a_clean_environment_from_any_folder(built, tmp_path):
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    python = tmp_path / "venv/bin/python"
    own = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip()
    (Path(own) / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", built[1], cwd=tmp_path)
    elsewhere = tmp_path / "some where"
    elsewhere.mkdir()
    where = run(python, "-c", "import huesphere.render as render; print(render.__file__)", cwd=elsewhere)
    assert str(tmp_path / "venv") in where
    commands = tmp_path / "venv/bin"
    small = ["--set", "camera.resolution=[48,48]", "--transport", "direct"]
    run(commands / "render", "--config", "mozart_5lights.yaml", *small, cwd=elsewhere)
    run(commands / "evaluate", "run", "--method", "least-squares", cwd=elsewhere)
    assert (elsewhere / "run/report/index.html").stat().st_size > 10_000
    assert "mozart_5lights.yaml" in run(commands / "render", "--list", cwd=elsewhere)
