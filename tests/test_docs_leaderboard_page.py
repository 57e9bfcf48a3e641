"""The leaderboard's page in a real browser: rows in order, numbers of the row files, readable on a phone and at night.

The page is built by Sphinx in the documentation's own configuration, without its other pages. Drives Debian's chromium
(`apt-get install chromium`); without it these tests are skipped.
"""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt-get install chromium")
sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install huesphere[dev]")

DOCS = Path(__file__).resolve().parent.parent / "docs"
CONFIG = """
import runpy

own = runpy.run_path({conf!r})
globals().update({{name: value for name, value in own.items() if not name.startswith("__")}})
root_doc = "leaderboard"
html_static_path = [{static!r}]


def setup(app):  # as in the documentation, without the files that it writes at the start of a build
    connect = app.connect
    app.connect = lambda event, *rest: None if event == "builder-inited" else connect(event, *rest)
    own["setup"](app)
    app.connect = connect
"""
# The least contrast of text on its ground (WCAG 2.2: at least 4.5), with the words that have it, over what is shown.
CONTRAST = """() => {
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (rgb) => {
    const [r, g, b] = rgb.map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const [r, g, b, alpha = 1] = parts(getComputedStyle(e).backgroundColor);
      if (alpha === 1) return [r, g, b];
    }
    return [255, 255, 255];
  };
  const places = [...document.querySelectorAll("article h1, article h2, article h3, article p, article td, article th")]
    .flatMap((e) => [e, ...e.querySelectorAll("a, code, strong")])
    .filter((e) => e.innerText.trim() && e.checkVisibility());
  const found = places.map((e) => {
    const [a, b] = [light(parts(getComputedStyle(e).color)), light(ground(e))].sort((x, y) => y - x);
    return [(a + 0.05) / (b + 0.05), e.innerText];
  });
  return [found.length, ...found.sort((x, y) => x[0] - y[0])[0]];
}"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page as HTML."""
    folder = tmp_path_factory.mktemp("leaderboard")
    source, out = folder / "source", folder / "out"
    source.mkdir()
    shutil.copy(DOCS / "leaderboard.md", source)
    config = CONFIG.format(conf=str(DOCS / "conf.py"), static=str(DOCS / "_static"))
    (source / "conf.py").write_text(config, encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-q", str(source), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / "leaderboard.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def opened(browser, built: Path, width: int, scheme: str) -> Iterator[object]:
    """The page; on leaving, it must have had no error and asked for nothing but files."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
    page.on("request", lambda r: None if r.url.startswith(("file:", "data:")) else wrong.append(r.url))
    page.on("requestfailed", lambda r: wrong.append(f"failed: {r.url}"))
    page.goto(built.as_uri(), wait_until="load")
    yield page
    page.close()
    assert wrong == []


@pytest.fixture(scope="module")
def page(browser, built: Path) -> Iterator[object]:
    with opened(browser, built, 1280, "light") as page:
        yield page


@pytest.fixture(scope="module")
def rows() -> list[dict]:
    """What the row files hold, the most points first."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in (DOCS / "leaderboard").glob("*.json")]
    assert len(found) >= 3
    return sorted(found, key=lambda row: -row["points"])


def cells(table) -> list[list[str]]:
    return table.evaluate("e => [...e.rows].map((row) => [...row.cells].map((cell) => cell.innerText.trim()))")


def number(text: str) -> float:
    return float(text.lstrip("<"))


def test_rows_are_in_the_order_of_their_points_with_the_numbers_of_their_files(page, rows: list[dict]):
    head, *shown = cells(page.locator("article table").first)
    assert head[:3] == ["place", "method", "points"]
    assert [line[1] for line in shown] == [row["name"] for row in rows]
    points = [number(line[2]) for line in shown]
    assert points == sorted(points, reverse=True)
    for line, row in zip(shown, rows, strict=True):
        assert number(line[2]) == pytest.approx(row["points"], abs=0.0501)
        low, high = map(number, line[3].split(" – "))
        assert (low, high) == pytest.approx((row["low"], row["high"]), abs=0.0501)
        for text, value in ((line[4], row["median_deg"]), (line[5], row["mean_deg"]), (line[6], 100 * row["coverage"])):
            assert number(text) == pytest.approx(value, rel=6e-3)
        assert int(line[7]) == len(row["missing"])


def test_methods_share_a_place_only_where_their_intervals_meet(page, rows: list[dict]):
    _, *shown = cells(page.locator("article table").first)
    places = [int(line[0]) for line in shown]
    assert places[0] == 1
    for at, (place, row) in enumerate(zip(places, rows, strict=True)):
        leader = rows[place - 1]
        assert place - 1 <= at
        assert row["high"] >= leader["low"]
        if place - 1 == at and at:
            assert row["high"] < rows[places[at - 1] - 1]["low"]


def test_each_method_has_its_points_by_shape_and_surface(page, rows: list[dict]):
    tables = page.locator("article table").all()[1:]
    headings = page.locator("article h3").all_inner_texts()
    assert [text.rstrip("#¶ ") for text in headings] == [row["name"] for row in rows]
    for table, row in zip(tables, rows, strict=True):
        (_, *surfaces, _), *lines = cells(table)
        assert {line[0] for line in lines} == {*row["matrix"], "all"}
        for shape, *values, _ in lines[:-1]:
            own = [row["matrix"][shape][surface] for surface in surfaces]
            assert [float(value) for value in values] == pytest.approx(own, abs=0.501)
        assert float(lines[-1][-1]) == pytest.approx(row["points"], abs=0.501)


# Of the boxes that hold a table and no heading and scroll sideways, left and right edge of the narrowest; then all are
# scrolled. Without such a box, nothing.
SCROLL_BOX = """(e) => {
  const boxes = [];
  for (; !e.querySelector("h1, h2, h3"); e = e.parentElement)
    if (["auto", "scroll"].includes(getComputedStyle(e).overflowX)) boxes.push(e);
  const edges = boxes.map((box) => box.getBoundingClientRect()).map((r) => [r.left, r.right]);
  for (const box of boxes) box.scrollLeft = 9999;
  return edges.sort((a, b) => a[1] - a[0] - (b[1] - b[0]))[0] ?? [-1, -1];
}"""


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")])
def test_the_page_can_be_read_on_a_desk_on_a_phone_by_day_and_by_night(browser, built: Path, width: int, scheme: str):
    with opened(browser, built, width, scheme) as page:
        only_tables_scroll_sideways(page, width)
        text_stands_out(page, dark=scheme == "dark")


def only_tables_scroll_sideways(page, width: int) -> None:
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    page.evaluate("() => window.scrollTo(1000, 0)")
    assert page.evaluate("() => window.scrollX") == 0
    for table in page.locator("article table").all():
        left, right = table.evaluate(SCROLL_BOX)
        assert 0 <= left < right <= width
        last = table.locator("tr").nth(1).locator("td").last.bounding_box()
        assert left <= last["x"] <= last["x"] + last["width"] <= right + 1  # the last column can be reached


def text_stands_out(page, *, dark: bool) -> None:
    ground = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 150) == dark
    count, least, words = page.evaluate(CONTRAST)
    assert count > 50
    assert least >= 4.5, words
