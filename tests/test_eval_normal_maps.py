"""Normal maps of other programs: codings, formats, backgrounds and frames, and what is said of them."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image
from test_eval_fabricated_run import bump, evaluate, evaluated, fabricate_run, rotation, table
from test_recover_io_picture import write_png

from huesphere.configs.errors import InputError
from huesphere.eval.frame_detection import compare_frames
from huesphere.eval.frames import FRAMES, NAMED, OURS, parse_frame
from huesphere.eval.normal_map import read_map, read_normal_map
from huesphere.eval.score import read_items
from huesphere.render.exr import write_exr

SIZE = 32
TURN = rotation("y", 3.0)  # what is wrong in the maps, about 2.9° at the median pixel


def truth() -> tuple[np.ndarray, np.ndarray]:
    """(normals (H, W, 3) with 0 off the object, mask)."""
    _, normals, mask = bump(SIZE)
    return np.where(mask[..., None], np.nan_to_num(normals), 0.0), mask


def coded(normals: np.ndarray, full_scale: float = 1.0, background: float = 0.0) -> np.ndarray:
    """(n + 1)/2 of full scale, and ``background`` of it where there is no normal."""
    is_map = np.linalg.norm(normals, axis=-1, keepdims=True) > 0.5
    return np.where(is_map, (normals + 1) / 2, background) * full_scale


def write(path: Path, array: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        np.save(path, array)
    elif suffix == ".npz":
        np.savez(path, array)
    elif suffix == ".mat":
        scipy.io.savemat(path, {"N_est": array})
    elif suffix == ".exr":
        write_exr(path, {name: array[..., i] for i, name in enumerate("RGBA"[: array.shape[-1]])})
    elif suffix in (".tif", ".tiff"):
        tifffile.imwrite(path, array, photometric="rgb", planarconfig="separate" if len(array) == 3 else "contig")
    elif array.dtype == np.uint16:
        write_png(path, array)
    else:
        Image.fromarray(array).save(path, quality=100, subsampling=0) if suffix == ".jpg" else Image.fromarray(
            array
        ).save(path)
    return path


def error(path: Path, **options) -> tuple[float, np.ndarray, str]:
    """(largest of 95 % of the angles to the truth in degrees, pixels with a normal, message)."""
    normals, mask = truth()
    made = read_normal_map(path, "theirs", (SIZE, SIZE), mask=mask, **options)
    both = made.valid & mask
    angle = np.degrees(np.arccos(np.clip(np.sum(made.normals[both] * normals[both], axis=-1), -1, 1)))
    return float(np.quantile(angle, 0.95)), made.valid, made.message


FORMS = {
    "vectors.npy": lambda n: n.astype(np.float32),
    "vectors.mat": lambda n: 7.5 * n,
    "vectors.tif": lambda n: n.astype(np.float32),
    "vectors.npz": lambda n: n[None],  # a batch of one
    "vectors.exr": lambda n: n,
    "first.npy": lambda n: np.moveaxis(n, -1, 0)[None],
    "unit.npy": lambda n: coded(n),
    "unit.tif": lambda n: coded(n).astype(np.float32),
    "unit.exr": lambda n: coded(n),
    "bytes.npy": lambda n: np.round(coded(n, 255)),
    "integers.npy": lambda n: np.round(coded(n, 255)).astype(np.int64),
    "uint8.mat": lambda n: np.round(coded(n, 255)).astype(np.uint8),
    "uint8.png": lambda n: np.round(coded(n, 255)).astype(np.uint8),
    "uint8.PNG": lambda n: np.round(coded(n, 255)).astype(np.uint8),
    "uint8.tiff": lambda n: np.moveaxis(np.round(coded(n, 255)).astype(np.uint8), -1, 0),
    "uint8.jpg": lambda n: np.round(coded(n, 255, 0.5)).astype(np.uint8),
    "uint16.png": lambda n: np.round(coded(n, 65535)).astype(np.uint16),
    "uint16.tif": lambda n: np.round(coded(n, 65535)).astype(np.uint16),
    "bytes_in_uint16.tif": lambda n: np.round(coded(n, 255)).astype(np.uint16),
}


@pytest.mark.parametrize("name", FORMS)
def test_every_coding_in_every_format_is_the_same_map(tmp_path, name):
    worst, valid, message = error(write(tmp_path / name, FORMS[name](truth()[0])))
    assert worst < (3.0 if name.endswith("jpg") else 0.6)
    assert valid[truth()[1]].all()
    assert not valid[0, 0] or name.endswith("jpg")
    guessed = name.split(".")[0] in ("unit", "bytes", "integers", "bytes_in_uint16")
    assert ("decoded from (n + 1)/2" in message) == guessed


@pytest.mark.parametrize("background", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", ["a.png", "a.npy", "a.exr"])
def test_black_grey_and_white_are_no_normals(tmp_path, background, name):
    normals, mask = truth()
    normals[10:14, 10:14] = 0
    array = coded(normals, 255 if name.endswith("png") else 1, background)
    worst, valid, _ = error(write(tmp_path / name, np.round(array).astype(np.uint8) if name == "a.png" else array))
    assert worst < 0.6
    hole = np.zeros_like(mask)
    hole[10:14, 10:14] = True
    np.testing.assert_array_equal(valid, mask & ~hole)


@pytest.mark.parametrize("name", ["a.png", "b.png", "a.exr", "a.npy", "a.tif"])
def test_alpha_says_where_there_is_no_normal(tmp_path, name):
    normals, mask = truth()
    alpha = mask & (np.arange(SIZE) > SIZE // 3)
    flat = np.where(mask[..., None], normals, [0.0, 0.0, 1.0])  # the background is a normal too
    rgba = np.concatenate([coded(flat), alpha[..., None]], axis=-1)
    kind = {"a.png": np.uint8, "b.png": np.uint16}.get(name)
    array = rgba.astype(np.float32) if kind is None else np.round(rgba * np.iinfo(kind).max).astype(kind)
    worst, valid, _ = error(write(tmp_path / name, array))
    assert worst < 0.6
    np.testing.assert_array_equal(valid, alpha)


def test_vectors_that_are_positive_throughout_stay_vectors(tmp_path):
    octant = np.abs(np.random.default_rng(0).normal(size=(SIZE, SIZE, 3)))
    octant /= np.linalg.norm(octant, axis=-1, keepdims=True)
    found = read_map(write(tmp_path / "a.npy", octant), (SIZE, SIZE))
    assert found.note == ""
    np.testing.assert_allclose(found.vectors, octant, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("a.npy", 3.0 * np.random.default_rng(0).uniform(0, 1, (SIZE, SIZE, 3))),
        ("a.png", np.random.default_rng(0).integers(0, 90, (SIZE, SIZE, 3)).astype(np.uint8)),
    ],
)
def test_what_may_be_either_is_refused(tmp_path, name, array):
    with pytest.raises(InputError, match=r"no component is negative: coded as \(n \+ 1\)/2\?"):
        read_map(write(tmp_path / name, array), (SIZE, SIZE))


def test_a_little_ringing_below_zero_is_still_coded(tmp_path):
    array = coded(truth()[0])
    array[5, 5] = [-0.01, 0.4, 0.9]
    assert error(write(tmp_path / "a.npy", array))[0] < 0.6


@pytest.mark.parametrize(
    ("channels", "right"),
    [
        ("Beauty.R Beauty.G Beauty.B Normal.X Normal.Y Normal.Z", "Normal.X Normal.Y Normal.Z"),
        ("R G B world_normals.R world_normals.G world_normals.B", "world_normals.R world_normals.G world_normals.B"),
        ("R G B other.R other.G other.B", "R G B"),
        ("N.x N.y N.z", "N.x N.y N.z"),
    ],
)
def test_the_layer_of_an_exr_is_the_one_that_says_normals(tmp_path, channels, right):
    normals, _ = truth()
    junk = np.full((SIZE, SIZE), 0.3)
    axes = dict(zip(right.split(), np.moveaxis(normals, -1, 0), strict=True))
    write_exr(tmp_path / "a.exr", {name: axes.get(name, junk) for name in channels.split()})
    assert error(tmp_path / "a.exr")[0] < 0.6


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"a": np.ones((SIZE, SIZE, 3)), "b": np.ones((SIZE, SIZE, 3))}, "which array is the normal map.*arrays a, b"),
        ({"a": np.ones(3)}, "which array is the normal map"),
        ({"normals": np.full((SIZE, SIZE, 3), "x")}, "real numbers"),
        ({"normals": np.ones((SIZE, SIZE))}, r"shape \(32, 32\)"),
    ],
)
@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_archives_without_one_map_are_refused(tmp_path, content, message, suffix):
    path = tmp_path / f"a.{suffix}"
    np.savez(path, **content) if suffix == "npz" else scipy.io.savemat(path, content)
    with pytest.raises(InputError, match=message):
        read_map(path, (SIZE, SIZE))


def test_a_mask_in_an_archive_counts(tmp_path):
    normals, mask = truth()
    valid = mask & (np.arange(SIZE) < SIZE // 2)
    scipy.io.savemat(tmp_path / "a.mat", {"Normal_est": normals, "mask": valid})
    np.testing.assert_array_equal(error(tmp_path / "a.mat")[1], valid)


@pytest.mark.parametrize("content", [b"", b"MATLAB 7.3 MAT-file", b"\x89PNG\r\n\x1a\n", b"II*\0"])
@pytest.mark.parametrize("suffix", ["npy", "npz", "mat", "exr", "tif", "png", "jpg"])
def test_damaged_maps_are_one_line(tmp_path, suffix, content):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="readable"):
        read_map(path, (SIZE, SIZE))


# --- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMED)
def test_a_map_in_a_named_frame_is_turned_into_ours(tmp_path, name):
    frame = parse_frame(name)
    normals, mask = truth()
    theirs = normals @ frame.matrix  # the inverse of to_camera
    worst, valid, message = error(write(tmp_path / "a.npy", theirs), frame=frame)
    assert worst < 0.03  # arccos in single precision tells no less
    assert valid[mask].all()
    assert ("left-handed" in message) == (name in ("directx", "unity", "unreal"))


def test_directx_and_opencv_are_what_their_users_mean():
    np.testing.assert_array_equal(parse_frame("DirectX").to_camera(np.array([0.1, 0.2, 0.9])), [0.1, -0.2, 0.9])
    np.testing.assert_array_equal(parse_frame("opencv").to_camera(np.array([0.1, 0.2, -0.9])), [0.1, -0.2, 0.9])
    np.testing.assert_array_equal(parse_frame("opengl").matrix, np.eye(3))


def test_the_frames_are_all_48_and_half_of_them_left_handed():
    assert len({frame.axes for frame in FRAMES}) == len(FRAMES) == 48
    assert sum(frame.left_handed for frame in FRAMES) == 24
    assert parse_frame("auto") is None
    assert parse_frame("luf").axes == "LUF"
    for bad, hint in (("opengel", "'opengl' .did you mean"), ("RRU", "three letters"), ("", "three letters")):
        with pytest.raises(InputError, match=hint):
            parse_frame(bad)


@pytest.fixture
def run(tmp_path) -> Path:
    fabricate_run(tmp_path / "run", {"bump/linear": {}, "bump/full": {}}, size=SIZE)
    return tmp_path / "run"


def maps(folder: Path, axes: str, name: str = "theirs", turn: np.ndarray = TURN) -> Path:
    for transport in ("linear", "full"):
        write(folder / f"{name}/bump/{transport}.npy", truth()[0] @ turn.T @ parse_frame(axes).matrix)
    return folder


@pytest.mark.parametrize("axes", [frame.axes for frame in FRAMES])
def test_every_frame_is_found_but_for_the_one_that_a_hollow_surface_has(run, tmp_path, axes):
    maps(tmp_path / "maps", axes)
    items = read_items(run)
    paths = {item.id: {"theirs": tmp_path / f"maps/theirs/{item.id}.npy"} for item in items}
    finding = compare_frames(items, paths, "theirs", OURS)
    assert finding.pictures == 2
    if axes in ("RUB", "LDB"):
        assert not finding.differs
    else:
        assert (finding.best.axes, finding.differs) == (axes, True)
        assert finding.best_deg < 4 < finding.given_deg


# What is told of frames is no matter of figures, which would take most of the time.
no_figures = pytest.mark.usefixtures("without_figures")


def median(run: Path) -> float:
    return float(next(row for row in table(run) if row["method"] == "theirs")["median_deg"])


@no_figures
def test_another_frame_is_said_and_not_applied(run, tmp_path):
    done = evaluated(run, "--estimates", maps(tmp_path / "maps", "RDB"), "--method", "theirs")
    assert done.returncode == 0, done.stderr
    assert median(run) > 20
    (told,) = [part for part in done.stdout.split("\n\n") if part.lstrip().startswith("theirs: ")]
    told = " ".join(told.split())  # lines are broken at 80 columns
    assert "with y turned over" in told
    assert "left-handed" in told
    assert "would be 2.9° instead of" in told
    assert "is its y downward? --frame directx scores it so" in told
    assert "is its y downward?" in (run / "report/index.html").read_text()


@no_figures
@pytest.mark.parametrize("how", ["flag", "auto", "beside", "for all", "overruled"])
def test_a_frame_that_is_given_is_applied_and_named(run, tmp_path, how):
    folder = maps(tmp_path / "maps", "RDF")
    flag = {"flag": ["--frame", "opencv"], "auto": ["--frame", "auto"], "overruled": ["--frame", "RDF"]}.get(how, [])
    if how in ("beside", "overruled"):
        (folder / "theirs/frame.txt").write_text("OpenCV\n" if how == "beside" else "directx")
    if how == "for all":
        (folder / "frame.txt").write_text("opencv")
    done = evaluated(run, "--estimates", folder, "--method", "theirs", *flag)
    assert done.returncode == 0, done.stderr
    assert median(run) == pytest.approx(2.87, abs=0.01)
    assert "x right, y down, z away from the camera" in done.stdout
    assert ("found by its agreement with the truth of 2 pictures: 2.9° in it" in done.stderr) == (how == "auto")


@no_figures
def test_normals_that_face_away_are_refused_with_the_frame_that_fits(run, tmp_path):
    done = evaluated(run, "--estimates", maps(tmp_path / "maps", "RDF"), "--method", "theirs")
    assert done.returncode == 2
    assert "most normals face away from the camera" in done.stderr
    assert "--frame opencv scores it so" in done.stderr


@no_figures
def test_auto_leaves_a_hollow_result_hollow(run, tmp_path):
    done = evaluated(run, "--estimates", maps(tmp_path / "maps", "LDB"), "--method", "theirs", "--frame", "auto")
    assert done.returncode == 0, done.stderr
    assert median(run) > 20
    assert "is it hollow instead of bulging, or its frame LDB?" in done.stderr


@no_figures
def test_maps_are_scored_beside_a_method_of_ours_and_what_is_left_out_is_told(run, tmp_path):
    folder = maps(maps(tmp_path / "maps", "RUB"), "RUB", "others")
    done = evaluated(run, "--estimates", folder, "--method", "least-squares")
    assert {row["method"] for row in table(run)} == {"least-squares", "theirs", "others"}, done.stderr
    done = evaluated(run, "--estimates", folder, "--method", "theirs")
    assert {row["method"] for row in table(run)} == {"theirs"}
    assert "not scored, since --method does not name them: others" in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--frame", "opencv"], "--frame is for normal maps of other programs, expected --estimates DIR"),
        (["--estimates", "{maps}", "--frame", "opencw"], "did you mean it?"),
    ],
)
def test_a_frame_without_maps_or_meaning_is_refused(run, tmp_path, words, message):
    maps(tmp_path / "maps", "RUB")
    done = evaluate(run, *(word.replace("{maps}", str(tmp_path / "maps")) for word in words))
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert message in done.stderr
