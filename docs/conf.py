"""The documentation's site: Markdown by MyST, equations as MathML, nothing fetched from a network. `make docs`.

Pages of the Python interface (``api/``) are written at the start of a build from the templates in ``api/`` and the
packages that are installed. Building them neither imports Mitsuba nor compiles.
"""

import ast
import dataclasses
import inspect
import os
import pkgutil
import re
import textwrap
from importlib import import_module
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

project = "huesphere"
author = "The huesphere authors"
copyright = "the huesphere authors, BSD-3-Clause"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
highlight_language = "text"  # of blocks that name no language: commands and what they print
html_theme = "furo"
html_title = "huesphere"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
exclude_patterns = ["_build", "notebooks/*.ipynb"]
suppress_warnings = ["myst.header"]  # pages of studies begin at any level

API = ("huesphere", "huesphere.recover", "huesphere.render", "huesphere.eval", "huesphere.scenes", "huesphere.configs")
SOME_MODULES = {  # of the packages that are not about recovery, those that the pages name
    "huesphere.render": ("dataset", "layers", "relighting", "relief"),
    "huesphere.eval": ("score", "metrics", "report"),
    "huesphere.scenes": ("surfaces", "spectra"),
    "huesphere.configs": ("schema", "load"),
}


def write_api_pages(app: Any) -> None:
    """One page a package under ``api/``, and their index. A page is rewritten only where its text has changed."""
    folder = Path(app.srcdir) / "api"
    index, page, section = ((folder / f"{name}.md.in").read_text("utf-8") for name in ("index", "package", "module"))
    names = []
    for package in _packages():
        modules = _interface() if package == "huesphere" else [section.format(module=m) for m in _modules(package)]
        title = "huesphere" if package == "huesphere" else package.removeprefix("huesphere.")
        _write(folder / f"{package}.md", page.format(title=title, package=package, modules="\n".join(modules)))
        names.append(package)
    _write(folder / "index.md", index.format(pages="\n".join(names)))


def write_teaching_figure(app: Any) -> None:
    """Write the figure of docs/idea.md, and the plotting library that it loads, into the folder of static files."""
    import importlib.util

    from plotly.offline import get_plotlyjs

    static = Path(app.srcdir) / "_static"
    spec = importlib.util.spec_from_file_location("docs_teaching", Path(app.srcdir) / "teaching.py")
    assert spec is not None
    assert spec.loader is not None
    teaching = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(teaching)
    _write(static / "teaching.html", teaching.fragment())
    _write(static / "plotly.min.js", get_plotlyjs())


def _cell(text: str) -> str:
    """``text`` in a cell of a Markdown table, ``code`` as code."""
    return re.sub(r"([|*$<])", r"\\\1", text.replace("``", "`"))


def _write(path: Path, text: str) -> None:
    if not path.is_file() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def _packages() -> list[str]:
    """The packages that have a page: those of API, and all of ``huesphere.recover`` in the order of its docstring."""
    found = list(API)
    recover = import_module("huesphere.recover")
    inner = [m.name for m in pkgutil.iter_modules(recover.__path__, "huesphere.recover.") if m.ispkg]
    story = (recover.__doc__ or "").partition("\n\n")[2]
    inner.sort(key=lambda name: (story.find(name.rpartition(".")[2]) % (len(story) + 1), name))
    at = found.index("huesphere.recover") + 1
    return found[:at] + inner + found[at:]


def _interface() -> list[str]:
    """The public names of ``huesphere``: functions, then the methods by name, then records."""
    huesphere = import_module("huesphere")
    functions: list[str] = []
    records: list[str] = []
    for name in sorted(set(huesphere.__all__) - {"METHODS"}):
        is_class = isinstance(getattr(huesphere, name), type)
        directive = ("autoclass", "\n   :members:") if is_class else ("autofunction", "")
        text = f"```{{eval-rst}}\n.. {directive[0]}:: huesphere.{name}{directive[1]}\n```\n"
        (records if is_class else functions).append(text)
    rows = [f"| `{method.name}` | {_cell(method.does)} |" for method in huesphere.METHODS.values()]
    methods = ["`huesphere.METHODS` holds the methods by name; each takes an Observation and returns an Estimate.", ""]
    methods += ["| method | what it does |", "| --- | --- |", *rows, ""]
    return ["## Functions", "", *functions, "## Methods", "", *methods, "## Records", "", *records]


def _modules(package: str) -> list[str]:
    """The modules on the page of a package, in alphabetical order."""
    if package in SOME_MODULES:
        return [f"{package}.{name}" for name in SOME_MODULES[package]]
    path = import_module(package).__path__
    return [m.name for m in pkgutil.iter_modules(path, f"{package}.") if not m.ispkg and not m.name.endswith(".cli")]


def plain_prose(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are plain prose: all of it but ``code`` and lists is escaped, so that no text is taken for markup.

    Names of modules become links. To the docstring of a record its fields are added, with the comments beside them.
    """
    if what == "class" and isinstance(thing, type) and dataclasses.is_dataclass(thing):
        if (thing.__doc__ or "").startswith(f"{thing.__name__}("):
            lines.clear()  # Python's own, which only repeats the signature
        lines += ["", *_fields(thing)]
    out: list[str] = []
    for block in _blocks("\n".join(lines)):
        indented = block.startswith(" ")
        text = textwrap.dedent(block)
        if indented or text.startswith(">>> "):
            out += ["::", "", *("    " + line for line in text.splitlines()), ""]
        elif text.lstrip().startswith(("- ", "* ")):
            out += [
                _escaped(line) if line[:2] not in ("- ", "* ") else "- " + _escaped(line[2:]) for line in _items(text)
            ]
            out.append("")
        else:
            out += [_escaped(" ".join(text.split())), ""]
    lines[:] = out


def _blocks(text: str) -> list[str]:
    return [block for block in re.split(r"\n\s*\n", text) if block.strip()]


def _items(text: str) -> list[str]:
    """The items of a list, each on one line; what stands before the first is an item of its own."""
    items: list[str] = []
    for line in text.splitlines():
        if line[:2] in ("- ", "* ") or not items:
            items.append(line.strip())
        else:
            items[-1] += " " + line.strip()
    return items


def _escaped(text: str) -> str:
    """``text`` with reStructuredText's own characters escaped outside ``code`` and `code`."""
    out = []
    for number, part in enumerate(re.split(r"``(.+?)``|`([^`]+)`", text)):
        if part is None:
            continue
        if number % 3 == 0:
            out.append(re.sub(r"([\\*|_`])", r"\\\1", part))
        else:
            name = part if part.startswith("huesphere") else f"huesphere.{part}"
            out.append(f"\\ :py:mod:`{part} <{name}>`\\ " if _is_module(name) else f"\\ ``{part}``\\ ")
    return "".join(out)


def _is_module(name: str) -> bool:
    if not re.fullmatch(r"huesphere(\.[a-z_0-9]+)+", name):
        return False
    root = Path(import_module("huesphere.recover").__path__[0]).parent
    path = root / Path(*name.split(".")[1:])
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def _fields(record: type) -> list[str]:
    """A list item for each field of a dataclass, with its type and the comment on its line."""
    try:
        source = textwrap.dedent(inspect.getsource(record))
    except (OSError, TypeError):
        return []
    body = source.splitlines()
    found = []
    for node in ast.parse(source).body[0].body:  # type: ignore[attr-defined]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and not node.target.id.startswith("_"):
            comments = [re.search(r"\s#:? ?(.*)$", line) for line in body[node.lineno - 1 : node.end_lineno]]
            said = " ".join(match[1] for match in comments if match)
            kind = ast.unparse(node.annotation)
            found.append(f"- ``{node.target.id}``: ``{kind}``" + (f": {said}" if said else ""))
    return found


def without_defaults(app: Any, what: str, name: str, thing: Any, options: Any, signature: Any, returns: Any) -> Any:
    """No signature of a record: its fields are listed with what they mean."""
    if what == "class" and dataclasses.is_dataclass(thing):
        return "", None
    return None


def _inline(translator: Any, node: Any) -> None:
    translator.body.append(convert(node.astext()))
    raise _skip()


def _block(translator: Any, node: Any) -> None:
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>\n')
    raise _skip()


def _skip() -> Exception:
    from docutils.nodes import SkipNode

    return SkipNode()


def names_that_break(app: Any, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Let names and paths in the cells of tables break after a dot, an underscore or a slash, and nowhere else."""

    def breaking(cell: re.Match[str]) -> str:
        pieces = re.split(r'(<span class="pre">[^<]*</span>)', cell.group())
        return "".join(re.sub(r"(?<=\w)([._/])(?=\w)", r"\1<wbr>", p) if p.startswith("<span") else p for p in pieces)

    context["body"] = re.sub(r"<td.*?</td>", breaking, context.get("body", ""), flags=re.DOTALL)


def setup(app: Any) -> None:
    os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # compiled functions stay Python functions with a signature
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("builder-inited", write_api_pages)
    app.connect("builder-inited", write_teaching_figure)
    app.connect("html-page-context", names_that_break)
    app.connect("autodoc-process-docstring", plain_prose)
    app.connect("autodoc-process-signature", without_defaults)
