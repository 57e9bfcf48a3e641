"""The page on data sets: its loop is ten lines, runs, and learns."""

import re
from pathlib import Path

import numpy as np
from training_run import render_ellipsoids

from huesphere.eval.datasets.samples import RunSamples

PAGE = Path(__file__).resolve().parent.parent / "docs/datasets.md"


def test_the_loop_of_the_page_learns(tmp_path, mi, monkeypatch):
    """On shapes that it has not seen, the median error is a third of that of the best constant normal."""
    loop = next(b for b in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S) if "np" in b)
    assert len([line for line in loop.splitlines() if line.strip()]) <= 10
    render_ellipsoids(tmp_path, "run")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(loop, "docs/datasets.md", "exec"), names)
    seen = {sample["id"] for sample in names["samples"]}
    errors, constant = [], []
    for sample in RunSamples("run"):
        if sample["id"] in seen:
            continue
        rgb, normals = sample["rgb"][sample["mask"]], sample["normals"][sample["mask"]]
        found = np.c_[np.ones(len(rgb)), rgb, rgb**2, rgb * np.roll(rgb, 1, axis=1)] @ names["weights"]
        for guess, angles in ((found, errors), (np.broadcast_to(normals.mean(axis=0), normals.shape), constant)):
            cosine = np.einsum("nc,nc->n", guess, normals) / np.linalg.norm(guess, axis=1)
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    assert np.median(np.concatenate(errors)) < np.median(np.concatenate(constant)) / 3
