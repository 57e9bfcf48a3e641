"""Draw which files of ``recover`` run for each method, and in which order: docs/architecture.md and its drawing.

Usage: python docs/architecture.py. Each method is run on small pictures (those of ``tests/golden``) while the
interpreter reports every function that is called; a file's place is that of its first call. Files that hold compiled
functions alone, which the interpreter does not see, come right behind the first file that imports them.
"""

import ast
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from importlib import import_module
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RECOVER = ROOT / "recover"
sys.path.insert(0, str(ROOT / "tests" / "golden"))

PACKAGES = {  # in the order in which a picture meets them: what each gives to the next
    "pixels": "usable colours, their noise",
    "ellipsoid": "the ellipsoid ρᵀCρ = 1, and the pixels on it",
    "cues": "hints on the rotation",
    "rotation": "the rotation R, hence F and normals",
    "uniform_hue": "one matrix, where brightness varies",
    "lights": "directions and colours",
    "interreflection": "the picture without indirect light",
    "every_pixel": "labels and normals of all pixels",
    "depth": "depth, denoised normals",
    "baselines": "methods of others",
    "methods": "choose the steps",
    "geometry": "mathematics for all of them",
}
PICTURES = {  # of tests/golden/make.py, and what each shows
    "direct": "no noise",
    "noisy": "without cast shadows, noise of 0.3 % of full scale",
    "full-noisy": "with all interreflection, noise of 0.1 %",
    "hollow": "the inside of a bowl with all interreflection",
    "wide": "lights far off the camera's axis, noise of 0.1 %",
    "dome": "a sky and two distant lights in place of the gels",
    "near": "three near lights in place of the gels; their positions are told to recovery",
}
SIMPLE = ("direct", "noisy")  # for methods that take the same steps on every picture
CHOOSING = ("auto", "robust", "unbounce")
LEFT_OUT = ("parameters", "__init__", "table", "calling", "records")  # said once in the text, not in every column
SERVING = "geometry/"  # serves all stages, so that its files have no place in the order
ROW, COLUMN, LEFT, TOP = 17, 26, 340, 150  # pixels


HEAD = """\
# Architecture: which files run, and in which order

<!-- Written by docs/architecture.py. Edit that file, not this one. -->

A picture becomes an `Observation` in linear light (`recover/io/picture.py`, `render/dataset.py`), passes through a
method, and comes out as an `Estimate` (`recover/io/estimate.py`). `recover/methods/table.py` lists the methods; each is
called through `recover/methods/calling.py`, which decodes the picture to linear light if it is display-encoded, runs
the method, and adds to the diagnostics what follows from its result. Two records pass between the stages: a `Problem`
(colours, where they count, their noise, the indirect light that was removed; `recover/problem.py`) and a `Solution`
(the matrix F of the pixels that see every light, its covariance, its inliers; `recover/solution.py`). Packages with
tuned numbers read them from their own `parameters.py`.

A package imports only from packages that come before it in the order geometry, pixels, cues, ellipsoid, rotation,
uniform_hue, lights, depth, io, interreflection, every_pixel, trust, full_size, baselines, methods, rig;
`tests/test_structure.py` checks this. The methods choose the steps, so they come after every stage: they use the
stages, and no stage uses them. The table lists the packages of the stages in the order in which a picture meets them.
Four more packages stand around the stages: `recover/io/` reads pictures and writes estimates, `recover/trust/` gives
verdicts and stated errors, `recover/full_size/` recovers large pictures by way of a reduced one, and `recover/rig/`
calibrates rigs with a ball.
"""
CELLS = """\
The number in a cell is the place of the file's first call while the method runs on small pictures that the tests
keep in `tests/golden`. An empty cell: the method does not call the file on these pictures. Files of `geometry/`
serve all stages; they have no place in the order, and a dot where the method calls them. The pictures are, except
where it says otherwise, of the built-in bust under five gels with cast shadows:

{pictures}

The methods {choosing} choose their steps by the picture, and run on all of these; the others on {simple}.
"""


def main() -> None:
    order = orders()
    (ROOT / "docs" / "architecture.md").write_text(page(order), encoding="utf-8")
    (ROOT / "docs" / "images" / "architecture.svg").write_text(drawing(order), encoding="utf-8")


def orders(walk: Callable[[str, str], list[str]] | None = None) -> dict[str, list[str]]:
    """Of each method, the files of ``recover`` ("package/file") in the order of their first call.

    ``walk``: gives the files that run for a picture's name and a method; None: each method is run here.
    """
    from huesphere.recover.methods.table import METHODS

    walk = walk or _walk()
    found: dict[str, list[str]] = {}
    for method in METHODS:
        files = dict.fromkeys(file for name in pictures_of(method) for file in walk(name, method))
        found[method] = with_compiled([file for file in files if file.split("/")[-1] not in LEFT_OUT])
    return found


def pictures_of(method: str) -> tuple[str, ...]:
    """The pictures that a method is run on."""
    return tuple(PICTURES) if method in CHOOSING else SIMPLE


def _walk() -> Callable[[str, str], list[str]]:
    """A function that runs a method on a picture of ``tests/golden`` and returns the files that it calls."""
    from make import read_pictures

    from huesphere.recover.run import recover_one

    import_methods()
    pictures = read_pictures()

    def walk(name: str, method: str) -> list[str]:
        files: list[str] = []
        with reported(files):
            recover_one(pictures[name], method)
        return files

    return walk


def import_methods() -> None:
    """Import the file of every method: what runs when a file is imported is no part of the walk."""
    from huesphere.recover.methods.table import METHODS

    for one in METHODS.values():
        import_module(f"huesphere.recover.methods.{one.function.partition(':')[0]}")


@contextmanager
def reported(files: list[str]) -> Iterator[None]:
    """Within the block, files of ``recover`` whose functions are called are appended to ``files``, once each."""
    seen, known, root = set(files), set[CodeType](), str(RECOVER)

    def called(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if code in known:
            return
        known.add(code)
        # Bodies of modules and classes, which run when a file is imported, are no optimised code.
        if not code.co_flags & CO_OPTIMIZED or not code.co_filename.startswith(root):
            return
        name = Path(code.co_filename).resolve().relative_to(RECOVER).with_suffix("").as_posix()
        if "/" in name and name.split("/")[0] in PACKAGES and name not in seen:
            seen.add(name)
            files.append(name)

    # A tracing function that returns None hears of calls alone, which costs least.
    before = sys.gettrace(), threading.gettrace()
    sys.settrace(called)
    threading.settrace(called)
    try:
        yield
    finally:
        sys.settrace(before[0])
        threading.settrace(before[1])  # type: ignore[arg-type]


def with_compiled(files: list[str]) -> list[str]:
    """The files with those of compiled functions alone behind the first that imports them."""
    out: list[str] = []
    for file in files:
        out.append(file)
        for imported in imports(RECOVER / f"{file}.py"):
            if imported not in files and imported not in out and only_compiled(RECOVER / f"{imported}.py"):
                out.append(imported)
    return out


def imports(path: Path) -> list[str]:
    """Files of ``recover`` that a file imports, as "package/file"."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("huesphere.recover."):
            stem = node.module.removeprefix("huesphere.recover.").replace(".", "/")
            found += [stem, *(f"{stem}/{alias.name}" for alias in node.names)]
    return [name for name in dict.fromkeys(found) if (RECOVER / f"{name}.py").is_file()]


def only_compiled(path: Path) -> bool:
    """Whether every function of a file is compiled by Numba."""
    functions = [n for n in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(n, ast.FunctionDef)]
    return bool(functions) and all(any("njit" in ast.unparse(d) for d in f.decorator_list) for f in functions)


def rows(order: dict[str, list[str]]) -> list[str]:
    """Every file that runs for some method, by package in the order of the walk, then by its earliest place."""
    used = dict.fromkeys(file for files in order.values() for file in files)
    stages = [[file for file in files if not file.startswith(SERVING)] for files in order.values()]
    place = {file: min((files.index(file) for files in stages if file in files), default=0) for file in used}
    return sorted(used, key=lambda file: (list(PACKAGES).index(file.split("/")[0]), place[file], file))


def idle(order: dict[str, list[str]]) -> list[str]:
    """Files of the packages that no method calls on the pictures, but for those that LEFT_OUT names."""
    every = sorted(path.relative_to(RECOVER).with_suffix("").as_posix() for path in RECOVER.glob("*/*.py"))
    here = [file for file in every if file.split("/")[0] in PACKAGES and file.split("/")[1] not in LEFT_OUT]
    return [file for file in here if not any(file in files for files in order.values())]


def page(order: dict[str, list[str]]) -> str:
    """The text of docs/architecture.md."""
    parts = [
        HEAD,
        "| package | what it gives |",
        "| --- | --- |",
        *(f"| `recover/{name}/` | {gives} |" for name, gives in PACKAGES.items()),
        "",
        "![A table of files and methods; numbers tell the order](images/architecture.svg)",
        "",
        CELLS.format(
            pictures="\n".join(f"- `{name}`: {shows}" for name, shows in PICTURES.items()),
            choosing=_listed(CHOOSING),
            simple=_listed(SIMPLE),
        ),
        "## Method by method",
        "",
    ]
    for method, files in order.items():
        walk = " → ".join(f"`{file}`" for file in files if not file.startswith(SERVING))
        parts += [f"### {method}", "", walk, ""]
    parts += ["Files of `geometry/` are left out of these lists; the drawing has them.", ""]
    parts += ["## Files that no method needs on these pictures", "", ", ".join(f"`{f}`" for f in idle(order)) + ".", ""]
    return "\n".join(parts)


def _listed(names: tuple[str, ...]) -> str:
    """Names as code, in one phrase."""
    *first, last = (f"`{name}`" for name in names)
    return f"{', '.join(first)} and {last}"


def drawing(order: dict[str, list[str]]) -> str:
    """The drawing: a row for each file, a column for each method, the place of the file's first call in the cell."""
    files = rows(order)
    width, height = LEFT + COLUMN * len(order) + 90, TOP + ROW * len(files) + 20
    font = 'font-family="system-ui, sans-serif" font-size="12"'
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" {font}>']
    out.append(f'<rect width="{width}" height="{height}" fill="#fff"/>')
    for column, method in enumerate(order):
        x = LEFT + COLUMN * column + COLUMN / 2
        out.append(f'<text transform="translate({x + 4} {TOP - 8}) rotate(-50)">{escape(method)}</text>')
    package = ""
    for row, file in enumerate(files):
        y = TOP + ROW * row
        own, name = file.split("/", 1)
        if own != package:
            package = own
            out.append(f'<line x1="8" x2="{width - 8}" y1="{y}" y2="{y}" stroke="#b9c3ce"/>')
            out.append(f'<text x="10" y="{y + 13}" font-weight="600">{escape(own)}</text>')
        out.append(f'<text x="130" y="{y + 13}" fill="#333">{escape(name)}</text>')
        for column, of_method in enumerate(order.values()):
            if file in of_method:
                stages = [one for one in of_method if not one.startswith(SERVING)]
                place = stages.index(file) if file in stages else 0
                x, shade = LEFT + COLUMN * column, 92 - 50 * place / max(1, len(stages) - 1)
                ink = "#fff" if shade < 60 else "#123"
                box = f'x="{x + 1}" y="{y + 1}" width="{COLUMN - 2}" height="{ROW - 2}" rx="2"'
                where = f'x="{x + COLUMN / 2}" y="{y + 13}" font-size="10.5" text-anchor="middle" fill="{ink}"'
                out.append(f'<rect {box} fill="hsl(205 55% {shade:.0f}%)"/>')
                out.append(f"<text {where}>{place + 1 if file in stages else '·'}</text>")
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    main()
