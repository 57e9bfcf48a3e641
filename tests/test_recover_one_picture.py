"""Pictures by path: a first answer at once, stages that are told, several pictures at a time, more or less effort."""

import numpy as np
import pytest
from PIL import Image
from synthesis import dome, light_colours, shade

from huesphere.configs.errors import InputError
from huesphere.recover import one_picture
from huesphere.recover.io.estimate import read_estimate
from huesphere.recover.one_picture import recover_picture, recover_pictures
from huesphere.recover.stages import Stage, at_work_on, told_to
from huesphere.scenes.encoding import encode_srgb


@pytest.fixture
def picture(tmp_path):
    """A function that writes a picture of the name and its mask; it returns the path of the picture."""

    def write(name: str, size: int = 64):
        normals, mask = dome(size, elongation=0.9, bumps=0.04, cap=0.98)
        rgb = shade(normals, mask, light_colours("gels"), noise=0.002)[0].rgb
        Image.fromarray(np.round(255 * encode_srgb(np.clip(rgb / rgb.max(), 0, 1))).astype(np.uint8)).save(
            tmp_path / name
        )
        np.save(tmp_path / "mask.npy", mask)
        return tmp_path / name

    return write


def test_an_interrupt_leaves_the_first_answer_with_its_page(tmp_path, picture, monkeypatch):
    path, said = picture("a.png"), []
    real = one_picture.recover_one

    def interrupted(observation, method, most_pixels=None):
        if method == "auto":
            raise KeyboardInterrupt
        return real(observation, method, most_pixels)

    monkeypatch.setattr(one_picture, "recover_one", interrupted)
    with pytest.raises(KeyboardInterrupt):
        recover_picture(path, ["auto"], mask=tmp_path / "mask.npy", out=tmp_path / "out", report=said.append)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "First answer" in page
    assert (tmp_path / "out" / "auto-normals.png").is_file()
    assert any(line.startswith("first answer") for line in said)
    monkeypatch.undo()
    recover_picture(path, ["knit"], mask=tmp_path / "mask.npy", out=tmp_path / "out", report=said.append)
    assert "First answer" not in (tmp_path / "out" / "report.html").read_text()


def test_the_stages_of_a_method_are_told_in_their_order(tmp_path, picture):
    heard = []

    @one_picture.contextmanager
    def shown(title):
        yield lambda share, what: heard.append((title, share, what))

    recover_picture(picture("a.png", 48), ["auto"], mask=tmp_path / "mask.npy", out=tmp_path / "out", shown=shown)
    assert {title for title, _, _ in heard} == {"a.png auto"}
    shares = [share for _, share, _ in heard]
    assert shares == sorted(shares)
    assert {stage.told for stage in (Stage.ELLIPSOID, Stage.INTERREFLECTION, Stage.VERDICT)} <= {w for _, _, w in heard}
    at_work_on(Stage.LIGHTS)  # nobody listens
    with told_to(lambda share, what: heard.append(what)):
        at_work_on(Stage.LIGHTS)
    assert heard[-1] == Stage.LIGHTS.told


def test_several_pictures_have_a_folder_each_and_a_bad_one_does_not_stop_the_others(tmp_path, picture):
    paths = [picture("a.png"), tmp_path / "b.png", picture("c.png")]
    paths[1].write_bytes(b"no picture")
    said = []
    with pytest.raises(InputError, match=r"b\.png"):
        recover_pictures(
            paths,
            ["least-squares"],
            mask=tmp_path / "mask.npy",
            out=tmp_path / "out",
            jobs=2,
            report=said.append,
        )
    for name in ("a", "c"):
        assert (tmp_path / "out" / f"{name}-huesphere" / "report.html").is_file()
        assert sum(line.startswith(f"{name}.png: ") for line in said) == 1
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match="share a folder"):
        recover_pictures([paths[0], tmp_path / "other" / "a.png"])


def test_effort_says_on_how_many_pixels_lights_are_found(tmp_path, picture, monkeypatch):
    path = picture("a.png")
    monkeypatch.setitem(one_picture.EFFORTS, "quick", 500)
    for effort in ("quick", "thorough"):
        recover_picture(path, ["weak-integrability"], mask=tmp_path / "mask.npy", out=tmp_path / effort, effort=effort)
    quick, thorough = (
        read_estimate(tmp_path / e / "estimates", "weak-integrability")[0] for e in ("quick", "thorough")
    )
    assert quick.diagnostics["reduction"]["pixels"] <= 500
    assert "reduction" not in thorough.diagnostics
    assert quick.normals.shape == thorough.normals.shape
