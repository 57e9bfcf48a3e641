"""Photographs as scenes: folders made from a rendered sphere give the same pictures, truth, and least squares again."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from photograph_folders import write_luces, write_psm_images, write_stack

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config, load_configs
from huesphere.configs.photographed import Photographs
from huesphere.eval.calibrated import known_lights_estimate, run_references
from huesphere.eval.diligent import export_diligent
from huesphere.eval.metrics import COLUMNS, Row
from huesphere.eval.score import read_items, read_scene, score_case
from huesphere.eval.table import best_cells, markdown_table
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import open_run
from huesphere.render.manifest import sha256_of
from huesphere.render.photographs.read import open_photographs
from huesphere.render.relighting import relight
from huesphere.render.run import render_config, render_configs

REAL = Path(__file__).parents[2] / "shared" / "data" / "real"
needs_photographs = pytest.mark.skipif(
    not (REAL / "diligent_ball.npz").is_file(), reason="the DiLiGenT photographs are not here: they have no licence"
)
SIZE, LIGHTS = 40, 6


def quiet(*_):
    return


def render(run: Path, *sets: str, shape: Path | None = None, config: str = "photographs", **options):
    """Render one config without a word, and return its only item."""
    loaded = load_config(config, overrides=sets, shape=None if shape is None else str(shape))
    (item,) = render_config(loaded, run, progress=quiet, log=quiet, **options)
    return next(one for one in open_run(run) if one.id == item)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A matte sphere under six white lights, rendered; and folders of its single-light pictures in four layouts."""
    folder = tmp_path_factory.mktemp("photographs")
    angle = 2 * np.pi * np.arange(LIGHTS) / LIGHTS
    lights = [f"{{direction: [{0.5 * np.cos(a):.4f}, {0.5 * np.sin(a):.4f}, 1], spectrum: 1}}" for a in angle]
    sets = [f"camera.resolution=[{SIZE},{SIZE}]", "render.transport=[linear]", f"lights=[{','.join(lights)}]"]
    render(folder / "run", *sets, "surface.reflectance=0.7", config="sphere_quick")
    (item,) = read_items(folder / "run")
    diligent = export_diligent(item, folder)
    directions = np.loadtxt(diligent / "light_directions.txt")
    (run_item,) = open_run(folder / "run")
    truth = run_item.truth()
    layers = run_item.layers()
    pictures = np.repeat(0.7 * layers.images[:, 0, ..., None], 3, axis=3)
    held = (pictures, directions, truth.mask, truth.normals)
    return SimpleNamespace(
        run=folder / "run",
        truth=truth,
        layers=layers,
        directions=directions,
        pictures=pictures,
        layouts={
            "diligent": diligent,
            "luces": write_luces(folder / "luces", *held),
            "psm": write_psm_images(folder / "psm", "gray", *held[:3]),
            "npz": write_stack(folder / "stack.npz", *held),
        },
    )


@pytest.mark.parametrize(("layout", "step"), [("diligent", 2**-15), ("luces", 2**-14), ("psm", 2**-8), ("npz", 2**-15)])
def test_each_layout_gives_back_the_pictures_directions_and_normals_it_was_written_from(source, layout, step):
    normals = "sphere" if layout == "psm" else "file"
    opened = open_photographs(Photographs(kind="photographs", path=str(source.layouts[layout]), normals=normals))
    assert (opened.layout, opened.count) == (layout, LIGHTS)
    rows, columns = np.nonzero(source.truth.mask)
    row, column = np.nonzero(opened.mask)
    picture = opened.picture(2)[0]
    scale = picture[opened.mask].max() / source.pictures[2].max()  # DiLiGenT pictures are over the light's intensity
    whole = np.zeros((SIZE, SIZE, 3))
    top, left = rows.min() - row.min(), columns.min() - column.min()
    whole[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    seen = source.truth.mask
    assert np.abs(whole[seen] / scale - source.pictures[2][seen]).max() < 1.5 * step
    assert np.allclose(opened.directions, source.directions, atol=1e-5)
    found = np.full((SIZE, SIZE, 3), np.nan)
    found[top : top + picture.shape[0], left : left + picture.shape[1]] = opened.normals
    both = np.isfinite(found).all(axis=-1) & seen
    error = np.degrees(np.arccos(np.clip(np.sum(found[both] * source.truth.normals[both], axis=-1), -1, 1)))
    assert both.sum() > 0.97 * seen.sum()
    assert np.median(error) < (3 if layout == "psm" else 0.01)


def test_the_picture_is_the_weighted_sum_of_photographs_and_can_be_relit(source, tmp_path):
    weights = "[[1, 0, 0], [0, 0.5, 0], [0, 0, 0.25]]"
    sets = ("lights.0.numbers=[0,2,4]", f"lights.0.colours={{weights: {weights}}}", "camera.exposure=1")
    item = render(tmp_path / "run", *sets, shape=source.layouts["npz"])
    observation, seen = item.observation(), source.truth.mask
    mask = observation.mask
    expected = source.pictures[[0, 2, 4]][:, seen][:, :, 0] * np.array([1, 0.5, 0.25])[:, None]
    assert np.abs(observation.rgb[mask] - expected.T).max() < 2**-14
    assert np.abs(item.layers().picture() - observation.rgb)[mask].max() < 1e-6
    assert not observation.camera.known
    brighter = relight(item, ["lights.0.colours={weights: [[0, 0, 1], [1, 1, 0], [0, 0, 0]]}"])
    sums = source.pictures[[0, 2]][:, seen][:, :, 0]
    assert np.abs(brighter.rgb[mask] - np.stack([sums[1], sums[1], sums[0]], axis=1)).max() < 2**-14
    spectra = relight(item, ["lights.0.colours={spectra: [A, D65, 1]}"])  # warm, cold, equal energy
    own = np.linalg.lstsq(source.pictures[[0, 2, 4]][:, seen][:, :, 0].T, spectra.rgb[mask], rcond=None)[0]
    assert own[0, 0] > own[0, 2]
    assert own[1, 2] > own[1, 0] * own[0, 2] / own[0, 0]
    assert np.allclose(own[2], 1, atol=1e-3)  # mean 1 over 400–700 nm, seen by any camera
    with pytest.raises(InputError, match=r"lights.0.seed cannot change"):
        relight(item, ["lights.0.seed=3"])


def test_the_manifest_says_where_the_photographs_come_from(source, tmp_path):
    folder = shutil.copytree(source.layouts["diligent"], tmp_path / "set")
    item = render(tmp_path / "run", shape=folder)
    entry = json.loads((tmp_path / "run" / "manifest.json").read_text())["items"][0]
    assert (entry["source"], entry["photographs"]["layout"]) == ("photographs", "diligent")
    for name in ("filenames.txt", "light_directions.txt", "mask.png", "Normal_gt.mat", "001.png", "006.png"):
        assert entry["photographs"]["files"][name] == sha256_of(folder / name)
    assert item.truth().facts["lights"][0]["name"] == f"photograph {entry['photographs']['numbers'][0]}"
    render(tmp_path / "run", shape=folder)  # it is there
    (folder / "006.png").write_bytes((folder / "001.png").read_bytes())
    with pytest.raises(InputError, match="made by another config"):
        render(tmp_path / "run", shape=folder)


def test_a_sweep_over_seeds_and_colours_gives_as_many_items_and_the_same_lamps_for_a_seed(source, tmp_path):
    sets = ["sweep.lights.0.seed=[0,1]", "sweep.lights.0.colours=[lamps,natural]", "lights.0.count=3"]
    configs = load_configs("photographs", overrides=sets, shape=str(source.layouts["npz"]))
    render_configs(configs, tmp_path, progress=quiet, log=quiet)
    used = {item.id: item.entry["photographs"] for item in open_run(tmp_path)}
    assert len(used) == 4
    lamps, natural = (used[f"photographs-seed_1-colours_{kind}/full"] for kind in ("lamps", "natural"))
    assert lamps["numbers"] == natural["numbers"]
    assert np.linalg.cond(lamps["weights"]) < 2 < np.linalg.cond(natural["weights"])


def test_recovery_and_evaluation_take_the_run_like_any_other(source, tmp_path):
    item = render(tmp_path, "lights.0.seed=1", shape=source.layouts["diligent"])
    estimate = METHODS["weak-integrability"](item.observation())
    truth = item.truth()
    cosine = np.sum(estimate.normals * truth.normals, axis=-1)[estimate.valid]
    assert estimate.valid.sum() > 0.5 * truth.mask.sum()
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 5
    items = read_items(tmp_path)
    run_references(items, ["woodham1980"], overwrite=False, say=quiet)
    row = score_case(read_scene(items[0]), "woodham1980").score.row
    assert (row.status, row.knows) == ("ok", "lights known, a picture under each")
    assert "knows" in COLUMNS
    assert f"| woodham1980 [{row.knows}] |" in markdown_table([row])


def test_least_squares_under_known_lights_is_exact_where_every_light_is_seen(source):
    (item,) = open_run(source.run)
    estimate, truth = known_lights_estimate(item.layers(), item.truth()), item.truth()
    lit = (truth.attached_shadow == 0).all(axis=-1) & truth.mask
    error = np.degrees(np.arccos(np.clip(np.sum(estimate.normals * truth.normals, axis=-1)[lit], -1, 1)))
    assert error.max() < 0.05
    assert not np.allclose(estimate.normals[truth.mask & ~lit], truth.normals[truth.mask & ~lit], atol=1e-3)


def test_the_reference_is_no_method_of_recovery_and_is_never_the_best(source):
    assert "woodham1980" not in METHODS
    rows = [Row("a", "full", m, "ok", scored=9, mean_deg=e) for m, e in (("auto", 3.0), ("robust", 4.0))]
    rows.append(Row("a", "full", "woodham1980", "ok", scored=9, mean_deg=1.0, knows="lights known"))
    assert {index for index, _ in best_cells(rows)} == {0}


# ---- what is refused -------------------------------------------------------------------------------------------------


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:60])


# What is done to each file of a DiLiGenT folder, and the message.
DAMAGED = {
    "filenames.txt": [
        (lambda p: p.write_text("001.png\n002.png\n"), r"light_directions.txt: a line for each picture, got 6 lines"),
        (lambda p: p.write_text("../001.png\n" * 6), "a name that leads out of the folder"),
        (lambda p: p.write_text("\n"), "a list without names"),
        (lambda p: p.write_bytes(b"\xff\xfe\x00"), "not a text file in UTF-8"),
    ],
    "light_directions.txt": [
        (lambda p: p.write_text("0 0 1\n" * 5 + "0 0\n"), r"light_directions.txt: line 6, got 0 0, expected 3 numbers"),
        (lambda p: p.write_text("0 0 1\n" * 5 + "0 0 nan\n"), "line 6"),
        (lambda p: p.write_text("0 0 0\n" * 6), "a direction of length 0"),
        (lambda p: p.unlink(), r"light_directions.txt: no such file"),
    ],
    "light_intensities.txt": [(lambda p: p.write_text("1 1 0\n" * 6), "an intensity of 0 or less")],
    "mask.png": [(cut, "mask.png: not a readable picture"), (lambda p: p.unlink(), "mask.png: no such photograph")],
    "Normal_gt.mat": [(cut, "not a readable MATLAB file")],
    "001.png": [(cut, "001.png: not a readable picture"), (lambda p: p.unlink(), "001.png: no such photograph")],
}


@pytest.mark.parametrize(("name", "number"), [(name, n) for name, cases in DAMAGED.items() for n in range(len(cases))])
def test_a_damaged_folder_is_refused_in_one_line(source, tmp_path, name, number):
    folder = shutil.copytree(source.layouts["diligent"], tmp_path / "set")
    damage, message = DAMAGED[name][number]
    damage(folder / name)
    with pytest.raises(InputError, match=message) as caught:
        render(tmp_path / "run", "lights.0.count=all", shape=folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["surface.reflectance=0.3"], "surface: photographs have their own"),
        (["camera.resolution=[32,32]"], r"camera.resolution: photographs have their own \(shape.reduce"),
        (["render.transport=[direct,full]"], "photographs have all bounces"),
        (["render.seed=3"], r"lights.0.seed chooses"),
        (["lights=[{direction: [0, 0, 1]}]"], "one entry of kind 'photographed'"),
        (["lights.0.numbers=[0,0]"], "a photograph twice"),
        (["lights.0.numbers=[0,1]", "lights.0.count=2"], "count and numbers both say"),
        (["lights.0.numbers=[0,9]"], r"lights.0.numbers, got 9, expected 0 to 5"),
        (["lights.0.count=7"], r"lights.0.count, got 7, expected at most 6"),
        (["lights.0.count=2", "lights.0.colours={weights: [[1, 1, 1]]}"], "colours are given for 1 lights, and 2"),
        (["lights.0.colours={weights: [[1, -1, 1]]}"], "a weight below 0"),
        (["lights.0.colours={spectra: [Z99]}"], r"lights.0.colours.spectra.0"),
        (["lights.0.colours=velvet"], "lights"),
        (["shape.object=cat"], "shape.object is for psmImages"),
        (["shape.layout=luces"], "shape.layout=luces, got a file"),
        (["shape.reduce=16"], "an object of few pixels"),
    ],
)
def test_a_config_that_photographs_cannot_follow_is_refused(source, tmp_path, sets, message):
    with pytest.raises(InputError, match=message) as caught:
        render(tmp_path, *sets, shape=source.layouts["npz"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"pictures": np.zeros((2, 20, 20, 3)), "mask": np.ones((20, 20))}, "no true normals in this set"),
        ({"pictures": np.zeros((2, 20, 20, 1)), "mask": np.ones((20, 20))}, "pictures, got float64"),
        ({"pictures": np.zeros((2, 20, 20, 3))}, "no array 'mask'"),
        (
            {"pictures": np.zeros((2, 20, 20, 3)), "mask": np.ones((20, 20)), "normals": np.ones((20, 20, 3))},
            "normals that are not unit vectors",
        ),
        (
            {
                "pictures": np.zeros((4, 20, 20, 3)),
                "mask": np.ones((20, 20)),
                "normals": np.tile([0.0, 0.0, 1.0], (20, 20, 1)),
            },
            "black photographs",
        ),
    ],
)
def test_an_npz_that_holds_no_set_is_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "set.npz", **arrays)
    with pytest.raises(InputError, match=message):
        render(tmp_path / "run", shape=tmp_path / "set.npz")


def test_what_is_no_set_is_refused(source, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.npz").write_text("no npz")
    for path, message in (
        (tmp_path / "empty", r"filenames.txt \(DiLiGenT\), led_params.txt"),
        (tmp_path / "none", "no such folder or npz"),
        (tmp_path / "text.npz", "not a readable npz"),
        (source.layouts["psm"], "no true normals"),
    ):
        with pytest.raises(InputError, match=message):
            render(tmp_path / "run", shape=path)
    with pytest.raises(InputError, match=r"no photographs are named, expected render --shape"):
        render(tmp_path / "run")
    with pytest.raises(InputError, match="--engine is for rendered scenes"):
        render(tmp_path / "run", shape=source.layouts["npz"], engine="reference")
    with pytest.raises(InputError, match="one entry of kind 'photographed'"):
        load_config("mozart_5lights", shape=str(source.layouts["diligent"]))
    with pytest.raises(InputError, match=r"need shape\.kind photographs"):
        load_config("mozart_5lights", overrides=["lights=[{kind: photographed}]"])


# ---- published numbers -----------------------------------------------------------------------------------------------


@needs_photographs
@pytest.mark.parametrize(
    ("name", "published", "within"),
    # B. Shi et al., IEEE TPAMI 41(2), 2019, row BASELINE: means over the object. The cat is here in 2 × 2 means, which
    # lowers it: 8.45 became 8.00 for the mean of three channels.
    [("diligent_ball", 4.10, 0.02), ("diligent_cat", 8.41, 0.5)],
)
def test_calibrated_least_squares_on_photographs_has_the_published_error(tmp_path, name, published, within):
    item = render(tmp_path, "lights.0.colours=white", shape=REAL / f"{name}.npz")
    estimate, truth = known_lights_estimate(item.layers(), item.truth()), item.truth()
    cosine = np.sum(estimate.normals.astype(float) * truth.normals, axis=-1)[truth.mask]
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() == pytest.approx(published, abs=within)
