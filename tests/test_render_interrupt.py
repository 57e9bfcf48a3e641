"""Ctrl-C in the middle of light transport: heeded soon, said in one line, and nothing half done is left."""

import hashlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from huesphere.render.manifest import read_manifest

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
LONG = [
    *("--config", "sphere_quick", "--set", "camera.resolution=[96,96]", "--set", "render.target_rms=1e-4"),
    *("--set", "shape={kind: bowl, opening: 75, detail: 64}", "--set", "render.samples=1000000"),
]  # minutes of work
HEEDED = 10.0  # seconds; 1 on a quiet machine: what runs between two looks at the keyboard is one launch of rays


def interrupted(folder, *arguments, after):
    """(exit code, stdout, stderr, seconds) of a `render` that is interrupted ``after`` seconds of light transport."""
    process = subprocess.Popen(
        [BIN / "render", *LONG, *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # What a shell starts in the background ignores the signal, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        said = ""
        while "engine:" not in said:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            said += line
        time.sleep(after)
        sent = time.monotonic()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
        return process.returncode, said + out, err, time.monotonic() - sent
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def linear(tmp_path_factory):
    """A folder whose run has one finished item."""
    folder = tmp_path_factory.mktemp("interrupt")
    done = subprocess.run(
        [BIN / "render", *LONG, "--transport", "linear"], cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize(("engine", "after"), [("transport", 1.0), ("transport", 4.0), ("reference", 4.0)])
def test_an_interrupt_is_one_line_and_keeps_what_was_finished(linear, engine, after):
    before = {path: path.read_bytes() for path in linear.rglob("*") if path.is_file()}
    code, out, err, seconds = interrupted(linear, "--transport", "linear,full", "--engine", engine, after=after)
    assert (code, err.splitlines()[-1:]) == (1, ["interrupted: what was finished is kept"]), err
    assert "Traceback" not in out + err
    assert err.count("\n") == 1 + err.count(" s left\n")  # beside plain lines of progress
    assert "sphere_quick/linear: already there" in out
    assert seconds < HEEDED
    assert {path: path.read_bytes() for path in linear.rglob("*") if path.is_file()} == before
    assert [path.name for path in (linear / "run/sphere_quick").iterdir()] == ["linear"]
    (item,) = read_manifest(linear / "run")["items"]
    assert (item["id"], item["status"]) == ("sphere_quick/linear", "done")
    for entry in item["files"]:
        assert hashlib.sha256((linear / "run" / entry["path"]).read_bytes()).hexdigest() == entry["sha256"]


def test_what_was_interrupted_before_anything_was_finished_leaves_no_item(tmp_path):
    code, _, err, _ = interrupted(tmp_path, "--transport", "full", after=2.0)
    assert (code, err.splitlines()[-1:]) == (1, ["interrupted: what was finished is kept"]), err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
