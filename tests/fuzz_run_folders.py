"""Run folders as they may come from others, for fuzz.py: links, pipes and devices in them, names that lead elsewhere.

Whatever the commands make of one, they end soon, and all that lies outside the folder stays as it was.
"""

import contextlib
import json
import shutil
from functools import cache
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import numpy as np
from fuzz import check, flipped, refusing_well
from fuzz_files import NO_FILES, put_no_file

from huesphere.eval.report import write_report
from huesphere.recover.run import recover_run
from huesphere.render.dataset import Observation, Truth, write_observation, write_truth
from huesphere.render.manifest import describe_files, put_items, read_manifest, remove_remains
from huesphere.render.verify import verified

ITEM = "tiny/linear"
PLACES = (
    *("manifest.json", "tiny", ITEM, f"{ITEM}/item.json", f"{ITEM}/observation.exr", f"{ITEM}/truth.exr"),
    *(f"{ITEM}/config.yaml", f"{ITEM}/estimates", f"{ITEM}/estimates/least-squares.json", "report", "report/figures"),
    *(f"{ITEM}/estimates/least-squares.exr", "report/index.html", "tiny/.x.host.1.partial", "other/linear/item.json"),
)


@cache
def sound_run() -> Path:
    """A small run folder with a finished item and an estimate, made once."""
    run = Path(mkdtemp()) / "run"
    folder = run / ITEM
    folder.mkdir(parents=True)
    y, x = np.mgrid[:12, :12] / 6 - 0.95
    z = np.sqrt(np.maximum(4 - x**2 - y**2, 0))
    normals = np.stack([x, -y, z], axis=-1) / 2
    mask = np.ones((12, 12), bool)
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    F = np.array([[0.5, 0.1, 0.4], [0.1, 0.5, 0.4], [-0.3, -0.2, 0.5]])
    write_observation(folder / "observation.exr", Observation((normals @ F.T).astype(np.float32), mask))
    none = np.zeros((12, 12, 1), np.float32)
    write_truth(folder / "truth.exr", Truth(normals, z.astype(np.float32), mask, none, none))
    (folder / "config.yaml").write_text("recover: {methods: [least-squares]}\n")
    entry = {"id": ITEM, "status": "done", "seed": 0, "seconds": 0.0, "files": describe_files(folder, ITEM)}
    (folder / "item.json").write_text(json.dumps(entry))
    put_items(run, [entry])
    recover_run(run)
    return run


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def hostile_run_case(rng: Random, folder: Path) -> None:
    """A run folder with some of its parts replaced by links out of it, pipes, devices, folders, or damaged bytes."""
    run, victim = folder / "run", folder / "victim"
    shutil.copytree(sound_run(), run)
    for name in ("figures", "errors", "pictures", "linear/estimates"):
        (victim / name).mkdir(parents=True)
        (victim / name / "precious.txt").write_text("precious")
    for name in ("index.html", "item.json", "manifest.json", "linear/observation.exr", ".x.host.1.partial"):
        (victim / name).write_text("mine")
    for _ in range(rng.choice([1, 1, 2])):
        _spoil(rng, run / rng.choice(PLACES), victim)
    before = _contents(victim)  # a second place may lie beyond a link that was put at the first
    action = rng.choice(("verify", "recover", "again", "report", "tidy", "put"))
    with refusing_well():
        if action == "verify":
            list(verified(run))
        elif action in ("recover", "again"):
            recover_run(run, overwrite=action == "again")
        elif action == "report":
            write_report(run)
        elif action == "tidy":
            remove_remains(run)
        else:
            put_items(run, read_manifest(run)["items"])
    check(_contents(victim) == before, f"{action}: something outside the run folder was written or deleted")


def _spoil(rng: Random, path: Path, victim: Path) -> None:
    """Replace what is at ``path`` by something that should not be there."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        kind = rng.choice(("link", "link", "bytes", *NO_FILES))
        if kind == "bytes":
            small = path.is_file() and path.stat().st_size < 2**20  # else it was made a file of gigabytes before
            path.write_bytes(flipped(rng, path.read_bytes() if small else b"{}"))
            return
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
        if kind == "link":
            targets = [victim, victim / path.name, victim / "index.html", Path("/etc/hostname"), Path("..")]
            path.symlink_to(rng.choice(targets))
        else:
            put_no_file(path, kind)
