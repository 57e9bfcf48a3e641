"""What a training loop reads: crops, mirrors and turns that keep picture, normals and lights one scene."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from training_run import render_ellipsoids

from huesphere.configs.errors import InputError
from huesphere.eval.datasets.sample import Sample, read_sample
from huesphere.eval.datasets.samples import Augmentation, RunSamples, augmented
from huesphere.eval.datasets.splits import Shares
from huesphere.eval.datasets.symmetry import Symmetry, cropped, transformed
from huesphere.render.dataset import open_run
from huesphere.torch import RunDataset, channels_first

ALL = [Symmetry(mirrored, turns) for mirrored in (False, True) for turns in range(4)]
RANDOM = Augmentation(crop=(12, 12), mirror=True, turn=True)


@pytest.fixture(scope="module")
def run(tmp_path_factory, mi) -> Path:
    return render_ellipsoids(tmp_path_factory.mktemp("samples"), "run")


def shade(sample: Sample) -> np.ndarray:
    """The picture that the sample's normals, depth, lights and matrix say, computed from its arrays alone, (H, W, 3).

    Red: a distant light. Green: a point light, by its position in pixels from the middle. Blue: the row of F.
    """
    normals, depth = sample.images["normals"], sample.images["depth"]
    height, width = depth.shape
    row, column = np.indices((height, width))
    place = np.stack([column - (width - 1) / 2, (height - 1) / 2 - row, depth], axis=-1)
    toward = sample.vectors["light_positions"][1] - place
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    lit = [
        normals @ sample.vectors["light_directions"][0],
        np.sum(normals * toward, axis=-1),
        normals @ sample.vectors["colour_matrix"][2],
    ]
    return np.stack(lit, axis=-1)


@pytest.fixture
def scene() -> Sample:
    """A bumpy patch of 10 × 14 pixels under a distant and a point light, in single precision as files hold it."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(10, 14, 3)) + np.array([0, 0, 3])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    images = {"normals": normals, "depth": 2 * rng.normal(size=(10, 14)), "mask": np.ones((10, 14), bool)}
    vectors = {
        "light_directions": np.array([[0.48, 0.36, 0.8], [np.nan] * 3]),
        "light_positions": np.array([[np.nan] * 3, [9.0, -4.0, 20.0]]),
        "colour_matrix": rng.normal(size=(3, 3)),
        "principal_point": np.zeros(3),
    }
    sample = Sample("patch/direct", images, vectors, {"camera": {"focal_px": None}})
    return replace(sample, images=images | {"rgb": shade(sample)})


# ---- the law: the changed scene shows the changed picture ----------------------------------------------------------


@pytest.mark.parametrize("symmetry", ALL)
def test_a_mirrored_or_turned_scene_shows_the_mirrored_or_turned_picture(scene, symmetry):
    new = transformed(scene, symmetry)
    assert np.allclose(shade(new), new.images["rgb"], atol=1e-6)
    assert np.allclose(np.linalg.norm(new.images["normals"], axis=-1), 1)


def test_without_turning_the_vectors_that_law_would_fail(scene):
    for symmetry in ALL[1:]:
        new = transformed(scene, symmetry)
        assert np.abs(shade(replace(new, vectors=scene.vectors)) - new.images["rgb"]).max() > 0.1


@pytest.mark.parametrize(("top", "left"), [(0, 0), (3, 5), (4, 8)])
def test_a_cropped_scene_shows_the_cropped_picture(scene, top, left):
    new = transformed(cropped(scene, top, left, (6, 6)), Symmetry(True, 1))
    assert np.allclose(shade(new), new.images["rgb"], atol=1e-6)
    whole = cropped(scene, top, left, (6, 6))
    assert np.array_equal(whole.images["rgb"], scene.images["rgb"][top : top + 6, left : left + 6])
    middle = [scene.images["mask"].shape[1] / 2 - left - 3, 3 + top - scene.images["mask"].shape[0] / 2, 0]
    assert np.allclose(whole.vectors["principal_point"], middle)


def test_a_turn_is_counter_clockwise_with_y_up():
    assert np.allclose(Symmetry(False, 1).matrix @ [1, 0, 0], [0, 1, 0])
    picture = np.zeros((3, 3))
    picture[1, 2] = 1  # to the right of the middle
    turned = transformed(Sample("a/b", {"mask": picture}, {}, {}), Symmetry(False, 1))
    assert turned.images["mask"][0, 1] == 1  # above it


@pytest.mark.parametrize("symmetry", ALL)
def test_four_turns_and_two_mirrors_are_none(scene, symmetry):
    back = scene
    for _ in range(4 if not symmetry.mirrored else 2):
        back = transformed(back, symmetry)
    assert all(np.allclose(back.images[n], scene.images[n], atol=1e-6) for n in scene.images)


# ---- what is drawn -------------------------------------------------------------------------------------------------


def test_every_window_has_the_object_and_all_symmetries_occur(scene):
    mask = np.zeros((10, 14), bool)
    mask[9, 13] = True
    sample = replace(scene, images=scene.images | {"mask": mask})
    drawn = [augmented(sample, Augmentation((4, 4), True, True), np.random.default_rng(n)) for n in range(200)]
    assert all(one.images["mask"].sum() == 1 for one in drawn)
    assert len({tuple(np.round(one.vectors["light_directions"][0], 3)) for one in drawn}) == 8
    oblong = [augmented(sample, Augmentation((4, 6), True, True), np.random.default_rng(n)) for n in range(50)]
    assert {one.images["mask"].shape for one in oblong} == {(4, 6)}


def test_samples_are_lazy_and_like_the_items(run):
    samples = RunSamples(run, ("normals", "depth", "lights"))
    assert len(samples) == 8
    item = open_run(run)[3]
    truth, sample = item.truth(), samples[3]
    assert np.array_equal(sample["rgb"], item.observation().rgb)
    assert np.array_equal(sample["normals"][truth.mask], truth.normals[truth.mask])
    assert not sample["normals"][~truth.mask].any()  # 0, not NaN
    assert np.isnan(RunSamples(run, fill=np.nan)[3]["normals"][~truth.mask]).all()
    assert samples[-1]["id"] == open_run(run)[-1].id
    assert [one["id"] for one in samples[1:3]] == [item.id for item in open_run(run)[1:3]]


def test_batches_are_the_same_with_any_number_of_workers_and_other_in_the_next_epoch(run):
    samples = RunSamples(run, ("normals", "masks", "lights"), augmentation=RANDOM, seed=5)
    batches = list(samples.batches(3, epoch=1))
    assert [batch["rgb"].shape for batch in batches] == [(3, 12, 12, 3)] * 2
    assert batches[0]["light_directions"].shape == (3, 3, 3)
    for other in (list(samples.batches(3, epoch=1, workers=n)) for n in (1, 3)):
        for one, two in zip(batches, other, strict=True):
            assert one["id"] == two["id"]
            assert all(np.array_equal(one[n], two[n], equal_nan=True) for n in one if n != "id")
    assert not np.array_equal(batches[0]["rgb"], next(samples.batches(3, epoch=2))["rgb"])
    assert [len(b["id"]) for b in samples.batches(3, keep_rest=True, shuffle=False)] == [3, 3, 2]
    assert next(iter(samples.batches(3, shuffle=False)))["id"] == [item.id for item in open_run(run)[:3]]


def test_splits_divide_the_samples(run):
    halves = Shares(0.5, 0.0, 0.5)
    parts = [RunSamples(run, split=split, shares=halves) for split in ("train", "test")]
    ids = [{sample["id"] for sample in part} for part in parts]
    assert not ids[0] & ids[1]
    assert ids[0] | ids[1] == {item.id for item in open_run(run)}
    with pytest.raises(InputError, match="no finished items of validation"):
        RunSamples(run, split="validation", shares=halves)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"contents": "normal"}, "did you mean it"),
        ({"split": "dev"}, "one of train, validation, test"),
        ({"transport": "full"}, "no finished items of full"),
        ({"augmentation": Augmentation(crop=(0, 3))}, "crop"),
        ({"augmentation": Augmentation(crop=7)}, "crop"),
    ],
)
def test_bad_options_are_one_line(run, options, text):
    with pytest.raises(InputError, match=text):
        RunSamples(run, **options)


def test_bad_batches_are_one_line(run, tmp_path):
    with pytest.raises(InputError, match="a crop larger than the picture"):
        RunSamples(run, augmentation=Augmentation(crop=(99, 9)))[0]
    with pytest.raises(InputError, match="size ≥ 1"):
        next(RunSamples(run).batches(0))
    with pytest.raises(InputError, match="no such run folder"):
        RunSamples(tmp_path / "none")
    with pytest.raises(IndexError):
        RunSamples(run)[8]


def test_pictures_of_two_sizes_need_a_crop(run):
    samples = RunSamples(run, augmentation=Augmentation(turn=True))
    whole = read_sample(samples.items[0])
    assert augmented(whole, samples.augmentation, np.random.default_rng(0)).images["rgb"].shape == (32, 24, 3)
    from huesphere.eval.datasets.samples import stacked

    with pytest.raises(InputError, match="different sizes"):
        stacked([{"rgb": np.zeros((2, 2, 3))}, {"rgb": np.zeros((3, 2, 3))}])


# ---- PyTorch -------------------------------------------------------------------------------------------------------


def test_without_pytorch_the_pip_line_is_named(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"pip install 'huesphere\[torch\]'"):
        RunDataset(run)


def test_the_package_is_imported_without_pytorch_and_optional_packages():
    code = (
        "import sys\nfor name in ('torch', 'pyarrow', 'h5py', 'webdataset', 'datasets'): sys.modules[name] = None\n"
        "import huesphere.torch, huesphere.eval.datasets.shards"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_channels_come_first():
    image = np.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5)
    moved = channels_first(image, (2, 3))
    assert moved.shape == (4, 5, 2, 3)
    assert moved[1, 2, 0, 2] == image[0, 2, 1, 2]
    assert channels_first(np.eye(3), (3, 3)).shape == (3, 3)


def test_tensors_of_a_data_loader_are_the_arrays(run):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed (its PyPI wheel for Linux needs CUDA: GBs)")
    data = RunDataset(run, ("normals", "masks", "lights"), augmentation=RANDOM)
    data.set_epoch(2)
    loader = torch.utils.data.DataLoader(data, batch_size=4, num_workers=2)
    samples = RunSamples(run, ("normals", "masks", "lights"), augmentation=RANDOM)
    for batch, wanted in zip(loader, samples.batches(4, epoch=2, shuffle=False), strict=True):
        assert batch["id"] == wanted["id"]
        assert batch["normals"].dtype == torch.float32
        assert torch.equal(batch["rgb"], torch.from_numpy(np.moveaxis(wanted["rgb"], -1, 1).copy()))
        assert torch.equal(batch["colour_matrix"], torch.from_numpy(wanted["colour_matrix"]))
