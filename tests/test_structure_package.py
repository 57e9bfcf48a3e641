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


PACKAGES = ("configs", "scenes", "render", "recover", "eval")
# A user's own files by the names of our folders: whatever imports one of them, ours or the standard library, fails.
OWN = "raise RuntimeError(f'{__file__} of the user was imported')\n"
CROWD = ("render/__init__.py", "configs/__init__.py", "recover.py", "eval.py", "scenes.py")


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Path:
    """The folder of commands of an environment in which the wheel is installed and the source tree is unknown."""
    folder = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    python = folder / "venv/bin/python"
    own = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    (own / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", built[1], cwd=folder)
    return folder / "venv/bin"


@pytest.fixture
def crowded(tmp_path) -> Path:
    """A folder of a user whose own modules have the names of our folders."""
    for name in CROWD:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(OWN)
    return tmp_path


def test_the_wheel_holds_every_module_and_the_data(built):
    with zipfile.ZipFile(built[1]) as wheel:
        inside = set(wheel.namelist())
    for package in ("huesphere", *PACKAGES):
        for path in (ROOT / package).rglob("*"):
            if path.suffix in (".py", ".yaml", ".json", ".j2", ".js", ".css", ".html"):
                installed = path.relative_to(ROOT) if package == "huesphere" else "huesphere" / path.relative_to(ROOT)
                assert installed.as_posix() in inside


def test_the_wheel_installs_no_other_top_level_name_than_huesphere(built):
    with zipfile.ZipFile(built[1]) as wheel:
        top = {name.split("/")[0] for name in wheel.namelist()}
        (listed,) = (name for name in wheel.namelist() if name.endswith(".dist-info/top_level.txt"))
        assert wheel.read(listed).decode().split() == ["huesphere"]
    assert {name for name in top if not name.endswith(".dist-info")} == {"huesphere"}


def test_the_wheel_works_in_a_clean_environment_from_any_folder(installed, tmp_path):
    elsewhere = tmp_path / "some where"
    elsewhere.mkdir()
    where = run(installed / "python", "-c", "import huesphere.render as render; print(render.__file__)", cwd=elsewhere)
    assert str(installed.parent) in where
    small = ["--set", "camera.resolution=[48,48]", "--transport", "direct"]
    run(installed / "render", "--config", "mozart_5lights.yaml", *small, cwd=elsewhere)
    run(installed / "evaluate", "run", "--method", "least-squares", cwd=elsewhere)
    assert (elsewhere / "run/report/index.html").stat().st_size > 10_000
    assert "mozart_5lights.yaml" in run(installed / "render", "--list", cwd=elsewhere)


def test_the_commands_run_beside_a_users_modules_named_like_our_folders(installed, crowded):
    """With the current folder first on the path, as PYTHONPATH=. has it; worker processes included."""

    def command(name: str, *arguments) -> str:
        return run(installed / name, *arguments, cwd=crowded, PYTHONPATH=".")

    sweep = ("--set", "camera.resolution=[48,48]", "--set", "sweep.camera.seed=[0,1]", "--transport", "linear")
    assert "2 items" in command("render", "--config", "sphere_quick", *sweep, "--jobs", "2")
    command("recover", "run", "--method", "least-squares", "--jobs", "2")
    assert "least-squares" in command("evaluate", "run", "--jobs", "2")
    assert (crowded / "run/report/index.html").is_file()
    for name in ("render", "recover", "evaluate"):
        assert command(name, "--version").startswith("huesphere ")


def test_the_python_interface_works_beside_a_users_modules_named_like_our_folders(installed, crowded):
    """A hemisphere under three coloured lights, its normals back within a degree."""
    code = """
import numpy as np
import huesphere as hs

y, x = (0.5 - np.indices((64, 64)) / 63) * 2.1 * np.array([1, -1])[:, None, None]
mask = x**2 + y**2 < 0.5
normals = np.dstack([x, y, np.sqrt(np.where(mask, 1 - x**2 - y**2, 0))])
F = np.array([[0.3, 0.1, 0.6], [-0.2, 0.25, 0.6], [0.0, -0.3, 0.6]])
noise = 1e-3 * np.random.default_rng(0).normal(size=normals.shape)
estimate = hs.recover_normals(normals @ F.T + noise, mask=mask, method="weak-integrability")
cosine = np.einsum("nc,nc->n", estimate.normals[estimate.valid], normals[estimate.valid])
assert "weak-integrability" in hs.METHODS
print(hs.__file__, estimate.status, np.degrees(np.arccos(np.median(cosine))) < 1)
"""
    where, status, near = run(installed / "python", "-c", code, cwd=crowded, PYTHONPATH=".").split()
    assert where.startswith(str(installed.parent))
    assert (status in ("ok", "convex-or-concave"), near) == (True, "True")  # a cap looks like a dish


def test_the_crowd_of_that_test_would_be_noticed(installed, crowded):
    """Importing any of the user's modules raises: the test above cannot pass by not being looked at."""
    for name in CROWD:
        module = name.split("/")[0].removesuffix(".py")
        done = subprocess.run(
            [installed / "python", "-c", f"import {module}"],
            cwd=crowded,
            env=os.environ | {"PYTHONPATH": "."},
            capture_output=True,
            text=True,
        )
        assert "of the user was imported" in done.stderr
