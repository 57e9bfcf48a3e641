"""The study of real photographs, on photographs made of a patchy sphere whose only fault is its paint."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.configs.study import load_study
from huesphere.eval.studies.page import markdown
from huesphere.eval.studies.real_photographs import AS_IT_IS, calibrated_albedo, sets_in
from huesphere.eval.studies.run import run_study
from huesphere.render.photographs.item import mix

SIZE, LIGHTS = 44, 9


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A folder with a sphere in two paints, a set without directions, and things that are no sets."""
    folder = tmp_path_factory.mktemp("sets")
    y, x = (0.5 - np.indices((SIZE, SIZE)) / (SIZE - 1)) * 2.1 * np.array([1, -1])[:, None, None]
    mask = x**2 + y**2 < 0.9
    normals = np.dstack([x, y, np.sqrt(np.where(mask, 1 - x**2 - y**2, 1))])
    angle = 2 * np.pi * np.arange(LIGHTS) / LIGHTS
    toward = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(LIGHTS, 0.87)], axis=1)
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    albedo = np.where(np.sin(9 * x) * np.sin(9 * y) > 0, 0.9, 0.35)[..., None] * np.array([1.0, 0.8, 0.6])
    pictures = np.maximum(normals @ toward.T, 0).transpose(2, 0, 1)[..., None] * albedo
    np.savez(folder / "patchy.npz", pictures=pictures, mask=mask, normals=normals, light_directions=toward)
    np.savez(folder / "unknown.npz", pictures=pictures, mask=mask, normals=normals)
    np.savez(folder / "untrue.npz", pictures=pictures, mask=mask)
    (folder / "notes").mkdir()
    return folder, albedo, mask


def study(*sets, path=None):
    given = ["lights=[lamps]", "mixes=1", "reduce=1", "methods=[least-squares]", "causes_method=least-squares", *sets]
    return load_study("real_photographs", overrides=given if path is None else [*given, f"path={path}"])


def test_only_sets_with_true_normals_count(sets):
    assert [path.name for path in sets_in(sets[0])] == ["patchy.npz", "unknown.npz"]
    with pytest.raises(InputError, match="no set of photographs with true normals"):
        sets_in(sets[0] / "notes")
    with pytest.raises(InputError, match="no such folder of photographs"):
        sets_in(sets[0] / "none")


def test_the_albedo_of_calibrated_photometric_stereo_is_the_true_one_where_all_lights_are_seen(sets):
    folder, albedo, _ = sets
    mixed = mix(load_config("photographs", shape=str(folder / "patchy.npz")))
    found = calibrated_albedo(mixed)
    seen = mixed.photographs.mask & (mixed.photographs.normals[..., 2] > 0.75)
    rows, columns = np.nonzero(seen)
    top = np.nonzero(sets[2])[0].min() - np.nonzero(mixed.photographs.mask)[0].min()
    left = np.nonzero(sets[2])[1].min() - np.nonzero(mixed.photographs.mask)[1].min()
    assert np.allclose(found[:, rows, columns].T, albedo[rows + top, columns + left], atol=1e-3)


@pytest.mark.slow
def test_removing_the_one_cause_there_is_removes_the_error(sets, tmp_path):
    found, page = run_study(study(path=sets[0]), tmp_path, jobs=1, log=lambda line: None)
    of = {(r["object"], r["cause"]): (r["verdict"], r["median_deg"]) for r in found.rows}
    for cause in (AS_IT_IS, "highlights clipped", "shaded with its albedo"):  # the paint is still there
        assert of["patchy", cause][0] == "failed", cause
    for cause in ("divided by its albedo", "shaded, even"):
        assert of["patchy", cause][1] < 6, cause
    assert of["patchy", "divided, shadows left out"][1] < 2
    assert [cause for name, cause in of if name == "unknown"] == [AS_IT_IS]  # nothing is known of its lights
    assert "divided by its albedo" in page.read_text()
    assert "patchy, lamps" in markdown(found)


def test_without_a_folder_the_study_says_in_one_line_that_it_is_skipped(tmp_path):
    found, page = run_study(study(), tmp_path, jobs=1, log=lambda line: None)
    assert found.answer == ("Skipped: no folder of photographs is given (--set path=FOLDER).",)
    assert page.is_file()
