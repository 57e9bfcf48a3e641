"""Cases of bad and odd input, and what must hold of them: an answer that is right, or one line that says what is wrong.

A case is made by a `random.Random` and nothing else: hypothesis gives one that it can shrink, benchmarks/run_fuzz.py
a seeded one. `CASES` is the table of kinds; each makes an input in a folder, feeds it to the program, and checks what
comes back.
"""

import contextlib
import json
import math
import signal
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import yaml

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.load import PACKAGED, dump_config, load_configs, packaged_names, validate
from huesphere.configs.schema import RunConfig
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation, open_run, write_observation
from huesphere.render.manifest import read_manifest
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.meshes.read import read_mesh
from huesphere.scenes.surfaces import depth_mesh, resample

SECONDS = 60  # a case that takes longer hangs
SCHEMA = RunConfig.model_json_schema()
ODD = (
    *(0, 1, -1, 2, 1e-12, 1e-3, 1e9, -1e9, 1e30, 1e308, math.inf, -math.inf, math.nan, True, None, "", " ", "x"),
    *("1e-3", "nan", "A", "D65", "D66", "light skin", "../../etc/passwd", "\0", "é" * 300, "a\nb", "{}", [], {}),
    *([[]], [1], [0, 0, 0], [1, 2, 3, 4], {"kind": "sphere"}, {"gaussian": {}}, {"csv": "none.csv"}, {"a": {"b": 1}}),
    *(10**30, -(2**63), 1.5, "2001-99-99", "!!python/none", "<script>"),
)
WORDS = (
    *("&a [*a]", "*a", "!!python/object/apply:os.system ['true']", "<<: {a: 1}", "{", "]", ": ", "- ", "|", ">", "#"),
    *("\t", "---", "...", "%YAML 9", "? ", "0x1f", "1_000", "1:30", "2001-01-01", "2001-99-99", ".inf", "~", "'", '"'),
    *(
        "\ufeff",
        "\u2028",
        "𝒳",
        "sweep: {count: 3, camera.seed: {integer: [0, 9]}}",
        "sweep: {shape: [1]}",
        "name: ../x",
    ),
)


class Wrong(AssertionError):
    """The program gave an answer that is none."""


def check(right: bool, what: str) -> None:
    if not right:
        raise Wrong(what)


@contextlib.contextmanager
def refusing_well() -> Iterator[None]:
    """Bad input may be refused: in one line. Anything else that is raised goes through."""
    try:
        yield
    except (InputError, Unfinished) as error:
        check(bool(str(error)) and "\n" not in str(error) and "Traceback" not in str(error), f"told badly: {error!r}")
        if isinstance(error, Unfinished):  # what failed for a reason that the user cannot mend has its type before it
            check("Error: " not in str(error), str(error))


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    def late(*_: Any) -> None:
        raise TimeoutError(f"took more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# ---- configs -------------------------------------------------------------------------------------------------------


def from_schema(rng: Random, node: dict[str, Any], odd: float) -> Any:
    """A value that the JSON Schema ``node`` allows, or with probability ``odd`` at each step something else."""
    if rng.random() < odd:
        return rng.choice(ODD)
    if "$ref" in node:
        return from_schema(rng, SCHEMA["$defs"][node["$ref"].rsplit("/", 1)[1]], odd)
    for key in ("anyOf", "oneOf"):
        if key in node:
            return from_schema(rng, rng.choice(node[key]), odd)
    if "const" in node:
        return node["const"]
    if "enum" in node:
        return rng.choice(node["enum"])
    kind = node.get("type")
    if kind == "object":
        needed = node.get("required", [])
        names = [n for n in node.get("properties", {}) if n in needed or rng.random() < 0.4]
        return {n: from_schema(rng, node["properties"][n], odd) for n in names}
    if kind == "array":
        if "prefixItems" in node:
            return [from_schema(rng, item, odd) for item in node["prefixItems"]]
        return [from_schema(rng, node["items"], odd) for _ in range(rng.randint(node.get("minItems", 0), 3))]
    if kind in ("number", "integer"):
        low = node.get("minimum", node.get("exclusiveMinimum", -10))
        high = node.get("maximum", node.get("exclusiveMaximum", max(low, 0) + 10))
        if kind == "integer":
            return rng.randint(math.ceil(low), math.floor(high))
        return rng.choice([low, high, low + (high - low) * rng.random(), low + (high - low) * rng.random()])
    if kind == "string":
        if "pattern" in node:
            return "fuzzed"
        return rng.choice(["A", "D65", "FL2", "light skin", "dark skin", "E", "Nikon 5100 (NPL)", "CIE 1931"])
    return rng.choice([True, False]) if kind == "boolean" else None


def mutated(rng: Random, text: str) -> str:
    """A few edits of a text: characters and lines taken out, doubled, moved; words put in, values put in place."""
    for _ in range(rng.randint(1, 4)):
        lines = text.split("\n")
        at, line = rng.randrange(len(text) + 1), rng.randrange(len(lines))
        edit = rng.randrange(7)
        if edit == 0:
            text = text[:at] + text[at + rng.randint(1, 8) :]
        elif edit == 1:
            text = text[:at] + rng.choice(WORDS) + text[at:]
        elif edit == 2:
            lines.insert(rng.randrange(len(lines) + 1), lines[line])
            text = "\n".join(lines)
        elif edit == 3:
            lines[line] = " " * rng.randint(0, 3) + lines[line]
            text = "\n".join(lines)
        elif edit == 4:
            key, colon, _ = lines[line].partition(":")
            lines[line] = f"{key}{colon} {json.dumps(rng.choice(ODD))}"
            text = "\n".join(lines)
        elif edit == 5:
            text = (
                text[:at] + chr(rng.choice([0, 9, 10, 13, 34, 39, 42, 58, 91, 123, 0x85, 0xFEFF, 0x1F600])) + text[at:]
            )
        else:
            text = text[:at]
    return text


def config_case(rng: Random, folder: Path) -> None:
    """A config file: mutated from a shipped one or made from the schema, with overrides now and then."""
    path = folder / "case.yaml"
    if rng.random() < 0.5:
        text = mutated(rng, (PACKAGED / rng.choice(packaged_names())).read_text(encoding="utf-8"))
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
    else:
        data = from_schema(rng, SCHEMA, odd=rng.choice([0.0, 0.02, 0.1]))
        if isinstance(data, dict) and rng.random() < 0.3:
            keys = ["camera.seed", "lights.0.intensity", "surface.reflectance", "shape", "lights.9.x", "name", "a.b"]
            what = [{"uniform": [0, 1]}, {"cone": 30}, {"choice": [1, 2]}, [0.5, 0.7], {"x": 1}, *ODD]
            data["sweep"] = {rng.choice(keys): rng.choice(what) for _ in range(rng.randint(0, 3))}
            data["sweep"] |= {"count": rng.choice([1, 3, 0, "x", 10**9])} if rng.random() < 0.5 else {}
        path.write_text(yaml.safe_dump(data), encoding="utf-8")
    keys = (
        "camera",
        "camera.bits",
        "lights.0",
        "lights.0.spectrum",
        "shape.kind",
        "sweep.camera.seed",
        "",
        "a",
        "name.x",
    )
    overrides = [f"{rng.choice(keys)}={rng.choice([*ODD, *WORDS])}" for _ in range(rng.choice([0, 0, 0, 1, 2]))]
    with refusing_well():
        for config in load_configs(str(path), overrides=overrides)[:20]:
            again = validate(yaml.safe_load(dump_config(config)), where="again")
            check(again == config, "a config that does not survive being written")
            check((folder / config.name).resolve().parent == folder.resolve(), f"a name that leads out: {config.name}")


def small(rng: Random, folder: Path) -> dict[str, Any]:
    """A config as the schema allows, cut down to what renders in a moment."""
    data = from_schema(rng, SCHEMA, odd=0.0)
    data["name"] = "fuzzed"
    while data["shape"]["kind"] in ("depth_map", "mesh"):
        data["shape"] = from_schema(rng, SCHEMA["properties"]["shape"], odd=0.0)
    if rng.random() < 0.15:
        data["shape"] = {"kind": "mesh", "path": mesh_file(rng, folder).name}
    elif rng.random() < 0.15:
        data["shape"] = {"kind": "depth_map", "path": depth_map_file(rng, folder).name}
    for node in (data["shape"], data.get("room") or {}):
        least = 32 if node.get("kind") == "bust" else 2 if node.get("kind") == "v_groove" else 8
        node |= {} if "path" in node else {"detail": least if "kind" in node else 2}
    data["camera"] = (data.get("camera") or {}) | {"resolution": [rng.randint(4, 12), rng.randint(4, 12)]}
    data["render"] = {"transport": rng.choice([["linear"], ["direct"], ["full"], ["direct", "one-bounce"]])}
    data["render"] |= {"target_rms": 0.3, "max_bounces": rng.choice([1, 3]), "samples": 2}
    return data


# Keys of the camera that make its samples others than the sum of the layers, which are the light that reaches it.
CHANGES_SAMPLES = ("blur", "vignetting", "filter_array", "response_spread", "dark_spread", "read_noise", "full_well")
CHANGES_SAMPLES += ("bits", "black_level")


def render_case(rng: Random, folder: Path) -> None:
    """A small scene that the schema allows: rendered, and what is on disk hangs together; or refused."""
    from huesphere.render.run import render_configs

    path = folder / "case.yaml"
    path.write_text(yaml.safe_dump(small(rng, folder)), encoding="utf-8")
    with refusing_well():
        configs = load_configs(str(path))
        render_configs(configs, folder / "run", progress=lambda *_: None, log=lambda _: None)
        for item in open_run(folder / "run"):
            seen, truth, config = item.observation(), item.truth(), item.config()
            check(bool(np.isfinite(seen.rgb).all()), "a picture that is not finite")
            check(bool((seen.mask == truth.mask).all() and seen.mask.any()), "masks that differ, or are empty")
            check(bool(np.isfinite(truth.depth[truth.mask]).all()), "depth that is not finite")
            n = truth.normals[truth.mask]
            check(bool(np.abs(np.linalg.norm(n, axis=-1) - 1).max() < 1e-3), "normals that are not unit vectors")
            check(bool(((truth.cast_shadow >= -1e-5) & (truth.cast_shadow <= 1 + 1e-5)).all()), "shadows outside 0 … 1")
            if config.camera.encoding == "linear" and not any(getattr(config.camera, key) for key in CHANGES_SAMPLES):
                whole = item.layers().picture()
                scale = max(1e-6, float(np.abs(seen.rgb).max()))
                check(float(np.abs(whole - seen.rgb).max()) < 1e-4 * scale, "layers that do not add to the picture")


# ---- files ---------------------------------------------------------------------------------------------------------


def flipped(rng: Random, data: bytes) -> bytes:
    """A file cut, lengthened, or with some bytes changed."""
    out = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        if out:
            at = rng.randrange(len(out)) if rng.random() < 0.5 else rng.randrange(min(len(out), 512))
            out[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
    edit = rng.random()
    if edit < 0.2:
        return bytes(out[: rng.randrange(len(out) + 1)])
    if edit < 0.3:
        return bytes(out) + rng.randbytes(rng.randint(1, 100))
    return bytes(out)


def odd_array(rng: Random, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of some kind and size, with what is not a number among them now and then."""
    numbers = np.random.default_rng(rng.randrange(2**32))
    kind = rng.randrange(9)
    if kind == 0:
        return np.zeros(shape)
    if kind == 1:
        return np.full(shape, rng.choice([1.0, -1.0, np.nan, np.inf, 1e9, 1e30, 1e-30]))
    if kind == 2:
        return numbers.integers(0, 255, shape).astype(rng.choice([np.uint8, np.uint16, np.int32, bool]))
    if kind == 3:
        return numbers.normal(size=shape).astype(rng.choice([np.float16, np.float32, np.complex128, "U3"]))
    values = numbers.normal(size=shape) * 10.0 ** rng.choice([-30, -3, 0, 0, 0, 3, 9, 30, 200])
    if kind >= 6:
        values.ravel()[numbers.random(values.size) < rng.random()] = rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e300])
    return values


def bumpy(rng: Random, side: int) -> np.ndarray:
    y, x = np.mgrid[:side, :side] / side - 0.5
    return 10 - 4 * side * (x**2 + rng.random() * y**2) + rng.random() * np.sin(9 * x)


def depth_map_file(rng: Random, folder: Path) -> Path:
    """A depth map of any shape, kind and size, whole or damaged."""
    shape = rng.choice([(0, 0), (1, 1), (1, 9), (2, 2), (4, 4), (9, 7), (16, 16), (5, 5, 3), (7,), ()])
    depth = bumpy(rng, 16) if rng.random() < 0.4 else odd_array(rng, shape)
    suffix = rng.choice([".npy", ".npz", ".txt", ".exr", ".png", ".tif"])
    path = folder / f"case{suffix}"
    save_array(path, depth, "depth", rng)
    if rng.random() < 0.4:
        path.write_bytes(flipped(rng, path.read_bytes()))
    return path


def depth_map_case(rng: Random, folder: Path) -> None:
    """A depth map file of any kind: a mesh with unit normals comes of it, or it is refused."""
    path = depth_map_file(rng, folder)
    with refusing_well():
        scale = rng.choice([1.0, 1.0, 1e-9, 1e9])
        grid = read_depth_map(path, depth_scale=scale, toward_camera=rng.random() < 0.5)
        check(bool(np.isfinite(grid.depth).all()) and grid.mask.any(), "a grid that is not finite, or empty")
        side = rng.choice([4, 9])
        grid = resample(grid, (side, side), side / max(grid.depth.shape))
        mesh, _ = depth_mesh(grid, 1.0)
        _check_mesh(mesh)


def save_array(path: Path, values: np.ndarray, name: str, rng: Random) -> None:
    """Write ``values`` in the format of the suffix as far as it can hold them; else as bytes that are no picture."""
    import imageio.v3
    import OpenEXR

    try:
        if path.suffix == ".npy":
            np.save(path, values)
        elif path.suffix == ".npz":
            extra = {"mask": odd_array(rng, values.shape[:2])} if rng.random() < 0.3 else {}
            np.savez(path, **{rng.choice([name, name, name, "other"]): values}, **extra)
        elif path.suffix == ".txt":
            np.savetxt(path, values)
        elif path.suffix == ".exr":
            planes = np.moveaxis(values.astype(np.float32), -1, 0) if values.ndim == 3 else [values.astype(np.float32)]
            channels = dict(zip("RGB" if values.ndim == 3 else "Z", planes))
            OpenEXR.File({}, {k: np.ascontiguousarray(v) for k, v in channels.items()}).write(str(path))
        else:
            imageio.v3.imwrite(path, np.nan_to_num(np.abs(values)).clip(0, 65535).astype(np.uint16))
    except Exception:  # the format has no place for such an array
        path.write_bytes(rng.randbytes(rng.randint(0, 200)))


def _check_mesh(mesh: Any) -> None:
    check(bool(np.isfinite(mesh.vertices).all()), "vertices that are not finite")
    check(mesh.faces.size == 0 or int(mesh.faces.max()) < len(mesh.vertices), "faces of vertices that are not there")
    length = np.linalg.norm(mesh.normals, axis=1)
    check(len(length) == 0 or bool(np.abs(length - 1).max() < 1e-6), "normals that are not unit vectors")


def mesh_file(rng: Random, folder: Path) -> Path:
    """A mesh of few triangles, flat ones, huge ones, not finite ones, or far off; now and then damaged."""
    import trimesh

    kind = rng.randrange(6)
    if kind == 0:
        vertices, faces = odd_array(rng, (rng.randint(0, 6), 3)), np.zeros((0, 3), int)
        faces = np.array([[rng.randint(0, 7) for _ in range(3)] for _ in range(rng.randint(0, 4))], int).reshape(-1, 3)
    else:
        ball = trimesh.creation.icosphere(subdivisions=1)
        vertices, faces = np.array(ball.vertices), np.array(ball.faces)
        if kind == 1:
            vertices = vertices * rng.choice([1e9, 1e-9, 1e30, 1e-30, 1e200, 0.0])
        elif kind == 2:
            vertices[rng.randrange(len(vertices))] = rng.choice([np.nan, np.inf, 1e9])
        elif kind == 3:
            faces[:: rng.randint(1, 5), 1] = faces[::1, 0][0]
        elif kind == 4:
            vertices[:, rng.randrange(3)] = 0.0
        else:
            vertices = vertices + np.array([0, 0, rng.choice([1e9, 1e15, -1e15])])
    suffix = rng.choice([".ply", ".ply", ".obj", ".stl", ".off"])
    path = folder / f"case{suffix}"
    path.write_text(_mesh_text(suffix, vertices, faces))
    if rng.random() < 0.4:
        path.write_bytes(flipped(rng, path.read_bytes()))
    return path


def mesh_case(rng: Random, folder: Path) -> None:
    """A mesh file of any kind: a sound mesh comes of it, or it is refused."""
    path = mesh_file(rng, folder)
    with refusing_well():
        mesh = read_mesh(
            path, rotation_deg=(0.0, rng.choice([0.0, 90.0]), 0.0), smooth_deg=rng.choice([0.0, 40.0, 180.0])
        )
        _check_mesh(mesh)
        check(len(mesh.faces) > 0, "no faces")
        check(float(np.abs(mesh.vertices[:, :2]).max()) < 1.001, "a mesh outside its frame")


def _mesh_text(suffix: str, vertices: np.ndarray, faces: np.ndarray) -> str:
    points = [
        " ".join(str(float(c)) for c in np.real(v).astype(float)) if v.dtype.kind != "U" else "x" for v in vertices
    ]
    if suffix == ".ply":
        head = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
        tail = "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
        rows = [*points, *(f"3 {a} {b} {c}" for a, b, c in faces)]
        return (head + tail).format(len(vertices), len(faces)) + "\n".join(rows) + "\n"
    if suffix == ".obj":
        return "\n".join([*(f"v {p}" for p in points), *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]) + "\n"
    if suffix == ".off":
        return f"OFF\n{len(points)} {len(faces)} 0\n" + "\n".join([*points, *(f"3 {a} {b} {c}" for a, b, c in faces)])
    corners = [points[i] if i < len(points) else "0 0 0" for face in faces for i in face]
    loops = [f"facet normal 0 0 1\nouter loop\nvertex {a}\nvertex {b}\nvertex {c}\nendloop\nendfacet" for a, b, c in
             zip(corners[::3], corners[1::3], corners[2::3])]  # fmt: skip
    return "solid x\n" + "\n".join(loops) + "\nendsolid x\n"


def picture_case(rng: Random, folder: Path) -> None:
    """A picture: of any size and kind, whole or damaged. Recovery says ok with unit normals, or names its failure."""
    shape = rng.choice(
        [(0, 0, 3), (1, 1, 3), (1, 40, 3), (3, 3, 3), (9, 9, 3), (16, 16, 4), (16, 16), (24, 24, 3), (12, 12, 2)]
    )
    values = odd_array(rng, shape)
    if rng.random() < 0.4:  # something like a picture
        depth = bumpy(rng, 24)
        p, q = np.gradient(depth, axis=1), -np.gradient(depth, axis=0)
        n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        F = np.random.default_rng(rng.randrange(99)).random((3, 3)) * rng.choice([1.0, 1e-6, 1e6])
        if rng.random() < 0.3:
            F[:, rng.randrange(3)] = F[:, 0]
        values = np.maximum(n @ F.T, 0)
        if rng.random() < 0.3:
            values = (
                np.where(odd_array(rng, values.shape).astype(float) > 0, values, np.nan)
                if rng.random() < 0.5
                else values
            )
    from fuzz_pictures import picture_file, picture_options  # which uses this module

    path = picture_file(rng, folder, values)
    region = tuple(rng.choice([0, 1, 5, 24, -1, 99]) for _ in range(4)) if rng.random() < 0.2 else None
    with refusing_well(), np.errstate(all="ignore"):
        mask = picture_file(rng, folder, odd_array(rng, values.shape[:2]), "mask") if rng.random() < 0.1 else None
        options = picture_options(rng, path)
        encoding = rng.choice(["auto", "auto", "srgb", "linear"])
        observation, how = read_picture(path, region=region, mask=mask, encoding=encoding, options=options)  # type: ignore[arg-type]
        check("\n" not in how, "words of several lines")
        estimate = recover_one(observation, rng.choice(list(METHODS)[:5]))
        shape2 = observation.mask.shape
        check(estimate.normals.shape == (*shape2, 3) and estimate.valid.shape == shape2, "an estimate of another size")
        check(estimate.status == "ok" or bool(estimate.message), "a failure without a word")
        check(not (estimate.valid & ~observation.mask).any(), "normals off the object")
        n = estimate.normals[estimate.valid]
        check(
            n.size == 0 or bool(np.abs(np.linalg.norm(n, axis=-1) - 1).max() < 1e-3),
            "normals that are not unit vectors",
        )
        check(estimate.status != "ok" or bool(estimate.valid.any()), "ok, and no normal")


def run_folder_case(rng: Random, folder: Path) -> None:
    """A run folder with a file damaged: read, and what is wrong is told."""
    item = folder / "run" / "a" / "linear"
    item.mkdir(parents=True)
    colours = np.random.default_rng(rng.randrange(2**32)).random((8, 8, 3)).astype(np.float32)
    write_observation(item / "observation.exr", Observation(colours, np.ones((8, 8), bool)))
    entry = {"id": "a/linear", "status": "done", "seed": 0, "seconds": 0, "files": []}
    (item / "item.json").write_text(json.dumps(entry))
    manifest = {"format_version": 1, "versions": {}, "items": [entry]}
    (folder / "run" / "manifest.json").write_text(json.dumps(manifest))
    target = rng.choice([item / "observation.exr", item / "item.json", folder / "run" / "manifest.json"])
    if target.suffix == ".json" and rng.random() < 0.5:
        data = manifest if target.name == "manifest.json" else entry
        data = json.loads(json.dumps(data))
        node = data if rng.random() < 0.3 else data["items"][0] if "items" in data else data
        node[rng.choice(list(node))] = rng.choice([x for x in ODD if not isinstance(x, float) or math.isfinite(x)])
        target.write_text(json.dumps(data))
    else:
        target.write_bytes(flipped(rng, target.read_bytes()))
    with refusing_well():
        read_manifest(folder / "run")
        for one in open_run(folder / "run"):
            check(one.folder.resolve().is_relative_to((folder / "run").resolve()), "a folder outside the run")
            seen = one.observation()
            check(seen.rgb.shape[:2] == seen.mask.shape, "shapes that differ")


CASES = {
    "config": config_case,
    "render": render_case,
    "depth map": depth_map_case,
    "mesh": mesh_case,
    "picture": picture_case,
    "run folder": run_folder_case,
}
