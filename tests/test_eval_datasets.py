"""A run as WebDataset, Parquet and HDF5: other programs open it, machines share the work, nothing is overwritten."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from training_run import render_ellipsoids

from huesphere.configs.errors import InputError
from huesphere.eval.cli import main
from huesphere.eval.datasets.card import About
from huesphere.eval.datasets.croissant import write_croissant
from huesphere.eval.datasets.sample import CONTENTS, geometry_key, read_sample
from huesphere.eval.datasets.shards import FORMATS, export_dataset
from huesphere.eval.datasets.splits import Shares, parse_shares
from huesphere.render.dataset import open_run
from huesphere.render.plan import Shard
from huesphere.render.relighting import relight

SHARES = Shares(0.6, 0.2, 0.2)
ABOUT = About("Ellipsoids", "CC-BY-4.0", shares=SHARES, shards=4)
KINDS = tuple(FORMATS)


@pytest.fixture(scope="module")
def run(tmp_path_factory, mi) -> Path:
    return render_ellipsoids(tmp_path_factory.mktemp("whole"), "run", left_out=("preview.png",))


@pytest.fixture(scope="module")
def halves(tmp_path_factory, mi) -> list[Path]:
    folder = tmp_path_factory.mktemp("halves")
    left_out = ("layers.exr", "preview.png")
    return [render_ellipsoids(folder, f"half{i}", shard=Shard(i, 2), left_out=left_out) for i in (1, 2)]


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory) -> dict[str, Path]:
    """The folder of each format, with all that a data set can hold."""
    folder = tmp_path_factory.mktemp("data")
    for kind in KINDS:
        if FORMATS[kind].package is not None:
            pytest.importorskip(FORMATS[kind].package)
        export_dataset(run, folder / kind, kind, About("All", "CC-BY-4.0", tuple(CONTENTS), SHARES, shards=4))
    return {kind: folder / kind for kind in KINDS}


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(capsys, *arguments) -> str:
    """The one line with which ``evaluate`` refuses these arguments."""
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def same(sample, arrays) -> bool:
    """Whether ``arrays``, by lower-case name, are those of the sample."""
    found = {name.lower(): np.asarray(array) for name, array in arrays.items()}
    return all(np.array_equal(found[n], a, equal_nan=True) for n, a in (sample.images | sample.vectors).items())


# ---- other programs ------------------------------------------------------------------------------------------------


def test_webdataset_opens_the_shards(run, exported):
    wds = pytest.importorskip("webdataset", reason="webdataset is not installed")
    urls = sorted(str(path) for path in exported["webdataset"].glob("*.tar"))
    rows = list(wds.WebDataset(urls, shardshuffle=False).decode())
    items = {item.id: item for item in open_run(run)}
    assert sorted(row["__key__"] for row in rows) == sorted(items)
    for row in rows:
        sample = read_sample(items[row["__key__"]], tuple(CONTENTS))
        arrays = {name.removesuffix(".npy"): row[name] for name in row if name.endswith(".npy")}
        assert same(sample, arrays)
        assert row["json"] == {"id": sample.id} | json.loads(json.dumps(sample.facts))


def test_datasets_opens_the_folder_with_its_splits(run, exported, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", reason="Hugging Face's datasets is not installed")
    datasets.disable_progress_bars()
    data = datasets.load_dataset(str(exported["huggingface"]), cache_dir=str(tmp_path)).with_format("numpy")
    items = {item.id: item for item in open_run(run)}
    assert sum(len(split) for split in data.values()) == len(items)
    for name, split in data.items():
        for row in split:
            item = items[str(row["id"])]
            sample = read_sample(item, tuple(CONTENTS))
            assert same(sample, {n: row[n] for n in sample.images | sample.vectors})
            assert SHARES.split_of(geometry_key(item.config())) == name


def test_h5py_opens_the_shards(run, exported):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    items, seen = {item.id: item for item in open_run(run)}, []
    for path in exported["hdf5"].glob("*.h5"):
        with h5py.File(path) as file:
            groups = [file[f"{config}/{transport}"] for config in file for transport in file[config]]
            for group in groups:
                sample = read_sample(items[group.name[1:]], tuple(CONTENTS))
                assert same(sample, {name: group[name][()] for name in group})
                seen.append(sample.id)
    assert sorted(seen) == sorted(items)


def test_croissant_validates_and_its_records_are_the_rows(exported, run):
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    folder = exported["huggingface"]
    data = croissant.Dataset(str(folder / "croissant.json"))
    assert not data.metadata.issues.errors
    read = [row for record_set in data.metadata.record_sets for row in data.records(record_set.uuid)]
    ids = [value.decode() for row in read for name, value in row.items() if name.endswith("/id")]
    assert sorted(ids) == sorted(item.id for item in open_run(run))


# ---- what is in it -------------------------------------------------------------------------------------------------


def test_albedo_layers_and_lights_make_the_picture(run):
    """Without noise the picture is the sum of the layers, and F n where every light of a direction is seen."""
    sample = read_sample(open_run(run)[0], tuple(CONTENTS))
    on = sample.images["mask"]
    total = (sample.images["direct"] + sample.images["indirect"]).sum(axis=2)
    assert np.allclose(total[on], sample.images["rgb"][on], atol=1e-6)
    assert not sample.images["indirect"].any()
    assert np.isnan(sample.images["albedo"][~on]).all()
    assert np.ptp(sample.images["albedo"][on], axis=0).max() == 0  # one reflectance
    red, green, blue = sample.images["albedo"][on][0]  # light skin: from 0.2 in the blue to 0.6 in the red
    assert 0.2 < blue < green < red < 0.6
    directions, positions = sample.vectors["light_directions"], sample.vectors["light_positions"]
    assert np.isfinite(directions).all(axis=1).tolist() == [True, True, False]
    assert np.isfinite(positions).all(axis=1).tolist() == [False, False, True]
    first = sample.images["direct"][:, :, 0].sum(axis=-1)
    shading = np.maximum(sample.images["normals"] @ directions[0], 0)
    assert np.corrcoef(first[on], shading[on])[0, 1] > 0.99999


def test_no_shape_is_in_two_splits_and_shares_hold():
    splits = [SHARES.split_of(str(number)) for number in range(4000)]
    for split, share in (("train", 0.6), ("validation", 0.2), ("test", 0.2)):
        assert abs(splits.count(split) / 4000 - share) < 0.03
    assert parse_shares("80, 10,10") == Shares(0.8, 0.1, 0.1)


def test_a_shape_under_other_lights_stays_in_its_split(run):
    config = open_run(run)[0].config()
    light = config.lights[0].model_copy(update={"direction": (0.0, 0.1, 1.0)})
    other = config.model_copy(update={"lights": (light, *config.lights[1:]), "name": "other"})
    assert geometry_key(other) == geometry_key(config)
    assert len({geometry_key(item.config()) for item in open_run(run)}) == 8


# ---- several machines ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_shards_of_two_machines_are_those_of_one(kind, run, halves, tmp_path):
    if FORMATS[kind].package is not None:
        pytest.importorskip(FORMATS[kind].package)
    export_dataset(run, tmp_path / "one", kind, ABOUT)
    for number, half in enumerate(halves):
        export_dataset(half, tmp_path / f"half{number}", kind, ABOUT)
        export_dataset(half, tmp_path / "both", kind, ABOUT)
    one = files(tmp_path / "one")
    assert len([name for name in one if name.endswith(FORMATS[kind].ending)]) > 3
    assert files(tmp_path / "both") == one
    first, second = (files(tmp_path / f"half{number}") for number in (0, 1))
    assert {name for name in first if name in second} <= {"README.md", "croissant.json"}
    if kind == "huggingface":  # copied together, then described again
        for name, data in second.items():
            (tmp_path / "half0" / name).write_bytes(data)
        write_croissant(tmp_path / "half0")
        assert files(tmp_path / "half0") == one


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ([], "--license is missing"),
        (["--license", "MIT", "--include", "normal"], "'normals' (did you mean it?)"),
        (["--license", "MIT", "--splits", "1,2"], "such as 80,10,10"),
        (["--license", "MIT", "--splits", "0,0,0"], "such as 80,10,10"),
        (["--license", "MIT", "--splits", "nan,1,1"], "such as 80,10,10"),
        (["--license", "MIT", "--shards", "0"], "1 to 100000"),
        (["--license", "MIT", "--include", "layers"], "rendered with --no-layers"),
    ],
)
def test_bad_options_are_one_line(options, line, halves, tmp_path, capsys):
    assert line in refused(capsys, halves[0], "--export", "webdataset", tmp_path / "out", *options)
    assert not list((tmp_path / "out").glob("*.tar")) if (tmp_path / "out").exists() else True


def test_options_of_data_sets_alone_are_refused(run, tmp_path, capsys):
    assert "is for --export webdataset" in refused(capsys, run, "--export", "npz", tmp_path, "--shards", "2")
    assert "is for --export webdataset" in refused(capsys, run, "--license", "MIT")


def test_nothing_that_is_there_is_written_over(run, tmp_path, capsys):
    arguments = (run, "--export", "webdataset", tmp_path / "out", "--license", "MIT")
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    assert end.value.code == 0
    assert "files with their records written" in capsys.readouterr().out
    before = files(tmp_path / "out")
    assert "is there already" in refused(capsys, *arguments)
    assert "another data set's card" in refused(capsys, *arguments, "--title", "Other", "--shards", "5")
    assert files(tmp_path / "out") == before


def test_no_link_is_followed_out_of_the_folder(run, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    os.symlink(tmp_path / "elsewhere", tmp_path / "out/data")
    pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match="a link"):
        export_dataset(run, tmp_path / "out", "huggingface", ABOUT)
    os.symlink(tmp_path / "elsewhere/card", tmp_path / "out/README.md")
    with pytest.raises(InputError, match="a link"):
        export_dataset(run, tmp_path / "out", "webdataset", ABOUT)
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_shard_that_cannot_be_finished_leaves_no_part_of_it(halves, tmp_path):
    import shutil

    damaged = Path(shutil.copytree(halves[0], tmp_path / "run"))
    last = sorted(damaged.glob("*/direct/truth.exr"))[-1]
    last.write_bytes(last.read_bytes()[:200])
    with pytest.raises(InputError, match=r"truth\.exr"):
        export_dataset(damaged, tmp_path / "out", "webdataset", About("x", "MIT", shares=Shares(1, 0, 0)))
    assert list(files(tmp_path / "out")) == ["README.md"]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if FORMATS[kind].package is not None])
def test_a_missing_package_is_named_with_its_pip_line(kind, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, FORMATS[kind].package, None)
    with pytest.raises(InputError, match=r"pip install 'huesphere\[data\]'"):
        export_dataset(run, tmp_path / "out", kind, ABOUT)
    assert not (tmp_path / "out").exists()


# ---- runs without layers and previews ------------------------------------------------------------------------------


def test_what_was_left_out_is_known_everywhere(halves, tmp_path, capsys):
    half = halves[0]
    item = open_run(half)[0]
    assert item.entry["left_out"] == ["layers.exr", "preview.png"]
    assert not (item.folder / "layers.exr").exists()
    assert not (item.folder / "preview.png").exists()
    for use in (item.layers, lambda: relight(item), lambda: relight(item.folder)):
        with pytest.raises(InputError, match="rendered with --no-layers"):
            use()
    assert "rendered with --no-layers" in refused(capsys, half, "--export", "diligent", tmp_path)
    with pytest.raises(SystemExit) as end:
        main([str(half), "--verify"])
    assert end.value.code == 0
    assert "items were rendered without layers.exr (--no-layers)" in capsys.readouterr().out


def test_going_on_with_and_without_layers(run, halves):
    """A file that is wanted and was left out is refused; one that is there and not wanted is kept."""
    with pytest.raises(InputError, match=r"made without layers\.exr and preview\.png: .*--no-layers --no-previews"):
        render_ellipsoids(halves[0].parent, "half1", shard=Shard(1, 2))
    with pytest.raises(InputError, match=r"made without layers\.exr: .*--no-layers"):
        render_ellipsoids(halves[0].parent, "half1", shard=Shard(1, 2), left_out=("preview.png",))
    render_ellipsoids(run.parent, "run", left_out=("layers.exr", "preview.png"))
    assert all((item.folder / "layers.exr").is_file() for item in open_run(run))


def test_a_run_without_layers_and_previews_is_evaluated(halves, tmp_path):
    from huesphere.eval.report import write_report
    from huesphere.recover.run import recover_run

    recover_run(halves[0], ["least-squares"], out=tmp_path)
    report = write_report(halves[0], ["least-squares"], out=tmp_path)
    assert report.page.is_file()
