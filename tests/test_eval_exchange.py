"""What goes out to other programs and comes in from them: DiLiGenT folders, archives, surfaces, normal maps."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import trimesh
from test_eval_fabricated_run import COLOURS, LIGHTS, bump, evaluate, evaluated, fabricate_run, rotation, table

from huesphere.configs.errors import InputError
from huesphere.eval.diligent import export_diligent, write_png16
from huesphere.eval.external_maps import find_external_maps
from huesphere.eval.normal_map import read_normal_map
from huesphere.eval.report import write_report
from huesphere.eval.score import read_items
from huesphere.recover.io.picture import read_picture
from huesphere.render.exr import write_exr
from huesphere.render.layers import Layers, write_layers

TURN = rotation("x", 2.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pictures with one estimate each, and layers as the renderer would write them."""
    folder = tmp_path_factory.mktemp("run")
    fabricate_run(folder, {f"bump/{t}": {"robust": TURN} for t in ("linear", "full")}, size=48)
    _, normals, mask = bump(48)
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    shading = np.maximum(np.nan_to_num(normals) @ towards.T, 0.0).astype(np.float32)
    images = np.moveaxis(shading, -1, 0)[:, None]
    material = np.where(mask, 0, -1)
    names = ("direct",)
    layers = Layers(images, names, COLOURS[:, None, None], material, np.zeros((48, 48, 3)), ("0", "1", "2"))
    for item in read_items(folder):
        write_layers(item.folder / "layers.exr", layers)
        facts = [{"name": str(n), "direction": list(map(float, d))} for n, d in enumerate(towards)]
        add_lights(item.folder / "truth.exr", facts)
    return folder


def add_lights(path: Path, lights: list[dict[str, object]]) -> None:
    from dataclasses import replace

    from huesphere.render.dataset import read_truth, write_truth

    truth = read_truth(path)
    write_truth(path, replace(truth, facts={**truth.facts, "lights": lights}))


# --- out --------------------------------------------------------------------------------------------------------------


def test_a_diligent_folder_gives_the_true_normals_by_plain_photometric_stereo(run: Path, tmp_path: Path):
    """Read as its readers do: images over intensities, least squares on the lights, against Normal_gt."""
    folder = export_diligent(read_items(run)[0], tmp_path)
    assert folder.name == "bump-linearPNG"
    names = (folder / "filenames.txt").read_text().split()
    L = np.loadtxt(folder / "light_directions.txt")
    intensities = np.loadtxt(folder / "light_intensities.txt")
    size = read_picture(folder / names[0])[0].rgb.shape
    assert (len(names), L.shape, intensities.shape, size) == (3, (3, 3), (3, 3), (48, 48, 3))
    images = np.stack([read_picture(folder / name, encoding="linear")[0].rgb for name in names])
    shading = (images / intensities[:, None, None]).mean(axis=-1)
    truth = scipy.io.loadmat(folder / "Normal_gt.mat")["Normal_gt"]
    np.testing.assert_allclose(np.loadtxt(folder / "normal.txt").reshape(truth.shape), truth, atol=1e-6)
    lit = (shading > 0.01).all(axis=0)
    assert lit.sum() > 500
    n = np.linalg.solve(L, shading[:, lit]).T
    np.testing.assert_allclose(n, truth[lit], atol=2e-4)  # albedo 1; 16 bits
    np.testing.assert_allclose(
        2 * read_picture(folder / "Normal_gt.png", encoding="linear")[0].rgb[lit] - 1, truth[lit], atol=4e-5
    )


def test_a_png_of_16_bits_comes_back_to_the_last_bit(tmp_path: Path):
    image = np.random.default_rng(0).integers(0, 65536, (5, 7, 3)) / 65535
    write_png16(tmp_path / "a.png", image)
    back = read_picture(tmp_path / "a.png", encoding="linear")[0].rgb
    np.testing.assert_array_equal(np.rint(back.astype(np.float64) * 65535), np.rint(image * 65535))


def test_what_diligent_cannot_hold_is_refused(run: Path, tmp_path: Path):
    (item, *_) = read_items(run)
    add_lights(item.folder / "truth.exr", [{"name": "0", "direction": None}])
    with pytest.raises(InputError, match="without one direction, got 0"):
        export_diligent(item, tmp_path)
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    add_lights(item.folder / "truth.exr", [{"name": str(n), "direction": list(d)} for n, d in enumerate(towards)])


def test_the_command_exports_and_scores_nothing(run: Path, tmp_path: Path):
    kinds = ("npz", "ply", "glb", "points", "diligent")
    done = evaluated(run, *(text for kind in kinds for text in ("--export", kind, tmp_path / kind)))
    assert done.returncode == 0, done.stderr
    assert "npz: 2 written" in done.stdout
    assert not (run / "report").exists()
    assert (tmp_path / "diligent/objects.txt").read_text().split() == ["bump-linearPNG", "bump-fullPNG"]
    arrays = np.load(tmp_path / "npz/bump/full.npz")
    _, normals, mask = bump(48)
    np.testing.assert_allclose(arrays["normals"][mask], normals[mask], atol=1e-6)
    np.testing.assert_allclose(arrays["estimate/robust/normals"][mask], (normals @ TURN.T)[mask], atol=1e-6)
    assert arrays["light_directions"].shape == (3, 3)
    for ending in ("ply", "glb"):
        mesh = trimesh.load_mesh(tmp_path / ending / f"bump/linear/robust.{ending}")
        assert len(mesh.vertices) == mask.sum()
        outward = np.einsum("ij,ij->i", mesh.face_normals, (normals @ TURN.T)[mask][mesh.faces[:, 0]])
        assert np.median(outward) > 0.99  # the faces look where the normals do
    cloud = trimesh.load(tmp_path / "points/bump/linear/robust.ply")
    np.testing.assert_allclose(
        np.asarray(cloud.vertices), trimesh.load_mesh(tmp_path / "ply/bump/linear/robust.ply").vertices, atol=1e-4
    )
    bad = evaluate(run, "--export", "diligant", tmp_path)
    assert (bad.returncode, "did you mean it?" in bad.stderr) == (2, True)


# --- in ---------------------------------------------------------------------------------------------------------------


def write_map(path: Path, normals: np.ndarray) -> None:
    """Write true vectors in the format of the path's ending; NaN where there are none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, np.moveaxis(3.0 * normals, -1, 0))  # channels first, of another length
    elif path.suffix == ".npz":
        np.savez(path, confidence=np.ones(3), normals=np.nan_to_num(normals))
    elif path.suffix == ".exr":
        write_exr(path, {name: normals[..., i] for i, name in enumerate("RGB")})
    else:
        write_png16(path, np.where(np.isfinite(normals), (normals + 1) / 2, 0.0))


@pytest.mark.parametrize(("suffix", "within"), [(".npy", 1e-5), (".npz", 1e-5), (".exr", 1e-5), (".png", 5e-3)])
def test_a_normal_map_of_another_program_is_read(tmp_path: Path, suffix: str, within: float):
    _, normals, mask = bump(48)
    normals[mask & (np.arange(48) < 12)] = np.nan
    write_map(tmp_path / f"map{suffix}", normals)
    made = read_normal_map(tmp_path / f"map{suffix}", "theirs", (48, 48))
    np.testing.assert_array_equal(made.valid, np.isfinite(normals[..., 0]))
    angle = np.degrees(np.arccos(np.clip(np.sum(made.normals * normals, axis=-1)[made.valid], -1, 1)))
    assert np.median(angle) < max(within, 0.03)  # arccos in single precision tells no less


def test_they_are_scored_beside_ours_and_the_run_is_left_alone(run: Path, tmp_path: Path):
    _, normals, _ = bump(48)
    write_map(tmp_path / "sdps/bump/linear.npy", normals @ TURN.T)
    before = {p for p in run.rglob("*") if "report" not in p.parts}
    write_report(run, estimates=find_external_maps(tmp_path, read_items(run)))
    assert {p for p in run.rglob("*") if "report" not in p.parts} == before
    rows = {(r["transport"], r["method"]): r for r in table(run)}
    assert set(rows) == {("linear", "robust"), ("full", "robust"), ("linear", "sdps")}
    theirs, ours = rows["linear", "sdps"], rows["linear", "robust"]
    assert theirs["status"] == "ok"
    assert theirs["seconds"] == ""
    for column in ("coverage", "mean_deg", "median_deg", "within_1"):
        assert float(theirs[column]) == pytest.approx(float(ours[column]), abs=1e-6)


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize(("named", "scored"), [("robust", {"robust", "one", "two"}), ("two", {"two"})])
def test_methods_that_are_named_leave_no_map_out_unless_a_map_is_named(
    run: Path, tmp_path: Path, named: str, scored: set[str]
):
    for name in ("one", "two"):
        write_map(tmp_path / name / "bump/linear.npy", bump(48)[1])
    done = evaluated(run, "--estimates", tmp_path, "--method", named)
    assert done.returncode == 0, done.stderr
    assert {row["method"] for row in table(run) if row["transport"] == "linear"} == scored


@pytest.mark.parametrize(
    "arguments",
    [
        ("--set", "camera.bits=8"),
        ("--verify", "--method", "robust"),
        ("--verify", "--estimates", "there"),
        ("--export", "npz", "there", "--estimates", "there"),
        ("--export", "npz", "there", "--overwrite"),
    ],
)
def test_an_option_that_would_have_no_effect_is_refused(run: Path, tmp_path: Path, arguments: tuple[str, ...]):
    done = evaluate(run, *(str(tmp_path) if word == "there" else word for word in arguments))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"{[word for word in arguments if word.startswith('--')][-1]} " in done.stderr


@pytest.mark.parametrize(
    ("place", "turn", "message"),
    [
        ("theirs/other/linear.npy", np.eye(3), "no normal map for any picture"),
        ("robust/bump/linear.npy", np.eye(3), "has an estimate of this name"),
        ("theirs/bump/linear.npy", np.diag([1.0, -1.0, -1.0]), "face away from the camera"),
    ],
)
def test_what_cannot_be_scored_is_refused(run: Path, tmp_path: Path, place: str, turn: np.ndarray, message: str):
    write_map(tmp_path / place, bump(48)[1] @ turn)
    with pytest.raises(InputError, match=message):
        write_report(run, estimates=find_external_maps(tmp_path, read_items(run)))


def test_a_map_of_another_size_is_refused(tmp_path: Path):
    np.save(tmp_path / "map.npy", np.ones((4, 5, 3)))
    with pytest.raises(InputError, match=r"got shape \(4, 5, 3\), expected \(48, 48, 3\)"):
        read_normal_map(tmp_path / "map.npy", "theirs", (48, 48))
