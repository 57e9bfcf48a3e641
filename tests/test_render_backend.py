"""The choice of LLVM: a library that would abort the process is never loaded, and without one rendering still works."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from huesphere.configs.errors import InputError
from huesphere.render import backend
from huesphere.render.oren_nayar import oren_nayar_bsdf
from huesphere.render.reference_albedo import albedo_texture
from huesphere.render.reference_environment import environment_emitter

REPOSITORY = Path(__file__).parent.parent
RENDER = "import sys; sys.argv[0] = 'render'; from huesphere.render.cli import main; main()"


def fake_library(folder: Path, name: str) -> Path:
    path = folder / name
    path.write_bytes(b"no library at all")
    return path


def run(arguments, tmp_path, **environment):
    env = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    env |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), **environment}
    return subprocess.run(
        [sys.executable, "-c", RENDER, *arguments], env=env, cwd=tmp_path, capture_output=True, text=True, timeout=170
    )


@pytest.mark.parametrize("name", ["libLLVM-15.so.1", "libLLVM.so.15", "libLLVM-15.so"])
def test_version_15_is_refused_by_its_name_without_a_trial(tmp_path, monkeypatch, name):
    monkeypatch.setattr(backend, "_survives", lambda *_: pytest.fail("a trial of LLVM 15"))
    assert "aborts" in backend._verdict(fake_library(tmp_path, name))


def test_a_symbolic_link_does_not_hide_version_15(tmp_path, monkeypatch):
    monkeypatch.setattr(backend, "_survives", lambda *_: pytest.fail("a trial of LLVM 15"))
    link = tmp_path / "libLLVM.so"
    link.symlink_to(fake_library(tmp_path, "libLLVM-15.so.1"))
    assert "aborts" in backend._verdict(link)


def test_old_and_missing_libraries_are_refused(tmp_path):
    assert "old" in backend._verdict(fake_library(tmp_path, "libLLVM-14.so.1"))
    assert backend._verdict(tmp_path / "libLLVM-19.so") == "no such file"


def test_a_library_that_dies_in_its_trial_is_refused_and_remembered(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    library = fake_library(tmp_path, "libLLVM-21.so")
    assert "did not survive" in backend._verdict(library)
    monkeypatch.setattr(backend.subprocess, "run", lambda *_, **__: pytest.fail("a second trial"))
    assert "did not survive" in backend._verdict(library)


QUICK = ["--config", "sphere_quick", "--set", "camera.resolution=[24,24]", "--set", "render.samples=16"]


@pytest.mark.skipif(
    not list(Path("/usr/lib").glob("*/libLLVM-15.so.1")), reason="no system libLLVM 15 to be protected from"
)
def test_the_users_own_wish_for_version_15_does_not_kill_the_process(tmp_path):
    library = next(iter(Path("/usr/lib").glob("*/libLLVM-15.so.1")))
    done = run(QUICK, tmp_path, DRJIT_LIBLLVM_PATH=str(library))
    assert done.returncode == 0, done.stderr
    assert "libLLVM-15" not in done.stdout


def test_without_llvm_it_says_so_and_renders_with_the_stock_scalar_engine(tmp_path):
    # HUESPHERE_LLVM=none: no library is even looked for.
    done = run([*QUICK, "--transport", "linear,full"], tmp_path, HUESPHERE_LLVM="none")
    assert done.returncode == 0, done.stderr
    assert "no usable LLVM" in done.stdout
    assert "engine: reference" in done.stdout
    assert (tmp_path / "run/sphere_quick/full/observation.exr").is_file()
    refused = run([*QUICK, "--engine", "transport", "--out", "other"], tmp_path, HUESPHERE_LLVM="none")
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: --engine transport needs LLVM or CUDA")


def test_verdicts_are_remembered_only_where_nobody_else_can_write(tmp_path, monkeypatch):
    library = fake_library(tmp_path, "libLLVM-19.so")
    trials = []

    class Survived:
        returncode, stdout = 0, "survived True"

    monkeypatch.setattr(backend.subprocess, "run", lambda *_, **__: trials.append(1) or Survived)
    shared = tmp_path / "shared"
    (shared / "huesphere").mkdir(parents=True)
    (shared / "huesphere").chmod(0o777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared))
    memory = backend._memory_file(backend.LLVM_VARIANT, library)
    memory.write_text('{"survived": false}')  # somebody else's word
    assert backend._survives(backend.LLVM_VARIANT, library)
    assert memory.read_text() == '{"survived": false}'
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))
    assert backend._survives(backend.LLVM_VARIANT, library)
    assert backend._survives(backend.LLVM_VARIANT, library)
    assert len(trials) == 2
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(backend, "_has_home", lambda: False)
    assert backend._memory_file(backend.LLVM_VARIANT, library) is None


@pytest.mark.parametrize(
    ("build", "what"),
    [
        (lambda mi: oren_nayar_bsdf(mi, 25.0, {}), "surface.kind: oren_nayar is rendered"),
        (lambda mi: albedo_texture(mi, None, None), "the reference engine has varying reflectance"),
        (lambda mi: environment_emitter(mi, []), "the reference engine has a sky"),
    ],
)
def test_what_is_written_in_python_is_refused_in_a_scalar_variant(build, what):
    with pytest.raises(InputError, match=f"{what} only with LLVM or CUDA, got {backend.SCALAR_VARIANT}"):
        build(SimpleNamespace(variant=lambda: backend.SCALAR_VARIANT))
