"""The report's page in a real browser: it loads clean, sorts, filters, turns, and reads out what the EXR holds.

Drives Debian's chromium (`apt-get install chromium`); without it these tests are skipped.
"""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_eval_fabricated_run import METHODS, fabricate_estimate, fabricate_run

from huesphere.eval.figures import core_panels
from huesphere.eval.page import CaseSection, ItemSection, render_pages, thumbnail
from huesphere.eval.report import PAGE_BYTES, write_report
from huesphere.eval.score import read_items, read_scene, score_case
from huesphere.eval.viewer import viewer_json
from huesphere.recover.io.estimate import read_estimate, write_estimate
from huesphere.recover.io.page import write_sheet
from huesphere.recover.lights.model import Light, Lights
from huesphere.render.dataset import read_observation
from huesphere.render.exr import read_exr

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt-get install chromium")
sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install huesphere[dev]")

EVIL = "<img src=x onerror=window.hit=1>'\"&"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pictures, three methods; one has failed, one has failed with a message that would like to be HTML."""
    folder = tmp_path_factory.mktemp("run")
    fabricate_run(folder, {"bump/linear": METHODS, "<b>bump</b>/full": METHODS}, noise=1e-3)
    fabricate_estimate(folder / "bump/linear", "drew-kontsevich", np.eye(3), declined=1.0, status="flat-surface")
    for item in ("bump/linear", "<b>bump</b>/full"):
        for method in METHODS:
            made, _ = read_estimate(folder / item / "estimates", method)
            light = Light(np.array([0.0, 0.6, 0.8]), np.ones(3), 100, 0.0, 1.0)
            made = replace(made, lights=Lights((light,), missing=0.5), diagnostics={EVIL: EVIL})
            write_estimate(folder / item / "estimates", made, folder / item / "observation.exr")
    evil = folder / "<b>bump</b>/full"
    made, _ = read_estimate(evil / "estimates", "least-squares")
    write_estimate(evil / "estimates", replace(made, status=EVIL, message=EVIL), evil / "observation.exr")
    with pytest.MonkeyPatch.context() as patch:  # its figures are tested elsewhere, and take most of the time
        patch.setattr("huesphere.eval.report.ALL_FIGURES_UP_TO", 0)
        patch.setattr("huesphere.eval.report.FIRST_AND_WORST", 0)
        write_report(folder)
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with sync_api.sync_playwright() as playwright:
        options = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page(browser, run: Path) -> Iterator[object]:
    with opened(browser, run / "report/index.html") as page:
        yield page


class opened:
    """A page at 1280 px with its inspector ready; on leaving, it must have had no error and asked for no network."""

    def __init__(self, browser, path: Path, *, width: int = 1280):
        self.page = browser.new_page(viewport={"width": width, "height": 900})
        self.wrong: list[str] = []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("console", lambda m: self.wrong.append(m.text) if m.type == "error" else None)
        self.page.on(
            "request", lambda r: None if r.url.startswith(("file:", "data:", "blob:")) else self.wrong.append(r.url)
        )
        self.path = path

    def __enter__(self):
        self.page.goto(self.path.as_uri())
        self.page.wait_for_selector("#inspector[data-shows]")
        return self.page

    def __exit__(self, kind, *_):
        self.page.close()
        if kind is None:
            assert self.wrong == []


def column(page, heading: str) -> list[str]:
    """The shown cells under a heading, from top to bottom."""
    number = page.locator("#results thead th").all_inner_texts()
    place = next(n for n, text in enumerate(number, start=1) if text.rstrip(" ▲▼") == heading)
    return page.locator(f"#results tbody tr:not([hidden]) td:nth-child({place})").all_inner_texts()


def test_a_click_on_a_heading_sorts_and_what_is_not_known_stays_last(page):
    heading = page.get_by_role("button", name="median", exact=True)
    heading.click()
    *known, unknown = column(page, "median")
    values = [float(text.lstrip("<")) for text in known]
    assert unknown == "–"
    assert values == sorted(values)
    assert len(set(values)) > 1
    heading.click()
    *known, unknown = column(page, "median")
    assert [float(text.lstrip("<")) for text in known] == values[::-1]
    assert unknown == "–"
    page.get_by_role("button", name="method", exact=True).click()
    names = [text.split("\n")[0] for text in column(page, "method")]
    assert names == sorted(names)


def test_filters_leave_what_was_asked_for(page):
    page.get_by_label("find").fill("bump full")
    assert page.locator("#filter-count").inner_text() == "3 of 6"
    assert set(column(page, "picture")) == {"<b>bump</b> · full"}
    page.get_by_label("find").fill("")
    page.locator("#filter-method").select_option("drew-kontsevich")
    assert len(column(page, "method")) == 2
    page.locator("#filter-status").select_option("flat-surface")
    assert column(page, "picture") == ["bump · linear"]
    page.locator("#filter-method").select_option("")
    page.locator("#filter-status").select_option("")
    assert page.locator("#filter-count").inner_text() == "6 of 6"


def test_the_read_out_is_the_number_that_the_exr_holds(page, run: Path):
    page.locator("a[data-look='picture-1-3']").first.click()
    page.wait_for_selector("#inspector[data-shows='picture-1-3']")
    error, _ = read_exr(run / "report/errors/bump/linear/least-squares.exr")
    made, _ = read_exr(run / "bump/linear/estimates/least-squares.exr")
    seen, _ = read_exr(run / "bump/linear/observation.exr")
    panes = page.locator("#panes")
    panes.scroll_into_view_if_needed()
    page.wait_for_function(
        "() => { const y = scrollY; return new Promise(r => setTimeout(() => r(y === scrollY), 150)) }"
    )
    box = panes.bounding_box()
    places = set()
    for share in (0.3, 0.55, 0.8):
        before = page.locator("#read-pixel").inner_text()
        page.mouse.move(box["x"] + box["width"] * (0.75 + 0.25 * share), box["y"] + 22 + (box["height"] - 22) * 0.5)
        page.wait_for_function("text => document.getElementById('read-pixel').textContent !== text", arg=before)
        x, y = map(int, page.locator("#read-pixel").inner_text().split(", "))
        assert abs(x - 64 * share) < 3  # the pixel under the pointer
        assert abs(y - 32) < 3
        places.add((x, y))
        assert float(page.locator("#read-error").inner_text().rstrip("°")) == float(f"{error['error_deg'][y, x]:.4g}")
        normal = [float(made[f"normal.{axis}"][y, x]) for axis in "XYZ"]
        assert numbers(page, "read-normal") == pytest.approx(normal, abs=0.5001e-3)
        assert numbers(page, "read-picture") == pytest.approx([seen[c][y, x] for c in "RGB"], abs=0.5001e-4)
    assert len(places) == 3


def numbers(page, name: str) -> list[float]:
    return [float(text) for text in page.locator(f"#{name}").inner_text().split()]


def at_a_pixel(page, anchor: str) -> tuple[int, int]:
    """Show a result and put the read-out on a pixel by the keyboard; its place."""
    page.locator(f"a[data-look='{anchor}']").first.click()
    page.wait_for_selector(f"#inspector[data-shows='{anchor}']")
    page.locator("#panes").press("Shift+ArrowLeft")
    page.wait_for_function("() => document.getElementById('read-pixel').textContent !== '–'")
    x, y = map(int, page.locator("#read-pixel").inner_text().split(", "))
    return x, y


def shown_error(page, run: Path, method: str, x: int, y: int) -> tuple[float, float]:
    """The error on the page, once the read-out is at (x, y), and that of the EXR."""
    page.wait_for_function("at => document.getElementById('read-pixel').textContent === at", arg=f"{x}, {y}")
    error, _ = read_exr(run / f"report/errors/bump/linear/{method}.exr")
    return float(page.locator("#read-error").inner_text().rstrip("°")), float(f"{error['error_deg'][y, x]:.4g}")


def test_arrow_keys_move_the_pixel_that_is_read_out(page, run: Path):
    x, y = at_a_pixel(page, "picture-1-3")
    for key, across, down in (("ArrowLeft", -1, 0), ("ArrowUp", 0, -1), ("Shift+ArrowUp", 0, -10), ("ArrowDown", 0, 1)):
        page.locator("#panes").press(key)
        x, y = x + across, y + down
        shown, held = shown_error(page, run, "least-squares", x, y)
        assert shown == held
    assert page.locator("#readout").get_attribute("aria-live") == "polite"
    spilt = "() => [...document.querySelectorAll('.readout div')].filter(e => e.scrollWidth > e.clientWidth).length"
    assert page.evaluate(spilt) == 0  # no number runs into the next


def test_another_method_is_read_out_at_the_same_pixel(page, run: Path):
    x, y = at_a_pixel(page, "picture-1-3")
    page.locator("a[data-look='picture-1-2']").first.click()
    page.wait_for_selector("#inspector[data-shows='picture-1-2']")
    shown, held = shown_error(page, run, "weak-integrability", x, y)
    assert shown == held


def test_plus_zooms_all_four_and_escape_shows_the_whole(page):
    at_a_pixel(page, "picture-1-3")
    axes = "['', 2, 3, 4].map(k => document.getElementById('panes')._fullLayout[`xaxis${k}`].range)"
    page.locator("#panes").press("+")
    page.wait_for_function(f"() => {axes}.every(([a, b]) => Math.abs(b - a - 32) < 1e-6)")
    page.locator("#panes").press("Escape")
    page.wait_for_function(f"() => {axes}.every(([a, b]) => b - a === 64)")


def test_what_takes_keys_has_a_name(page):
    for place in page.locator("[tabindex='0']").all():
        assert place.get_attribute("aria-label"), place.evaluate("e => e.outerHTML.slice(0, 80)")
    assert page.locator("[tabindex='0']").count() >= 5
    unnamed = (
        "() => [...document.querySelectorAll('input, select, button')].filter(e => !e.labels?.length && !e.innerText)"
    )
    assert page.evaluate(f"() => ({unnamed})().length") == 0


def test_a_drag_on_one_pane_zooms_them_all(page):
    panes = page.locator("#panes")
    box = panes.bounding_box()
    x, y = box["x"] + box["width"] * 0.05, box["y"] + box["height"] * 0.3
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 100, y + 100, steps=4)
    page.mouse.up()
    spans = "() => ['', 2, 3, 4].map(k => document.getElementById('panes')._fullLayout[`xaxis${k}`].range)"
    page.wait_for_function(f"() => {{ const r = ({spans})(); return r[0][1] - r[0][0] < 40 }}")
    ranges = page.evaluate(spans)
    assert all(each == pytest.approx(ranges[0]) for each in ranges)
    page.get_by_role("button", name="whole picture").click()
    page.wait_for_function(f"() => ({spans})()[3][1] === 63.5")


def test_the_colour_cloud_turns_under_the_pointer(page):
    page.locator("#cloud").scroll_into_view_if_needed()
    page.wait_for_selector("#cloud canvas")
    eye = "() => document.getElementById('cloud')._fullLayout.scene._scene.getCamera().eye"
    before = page.evaluate(eye)
    box = page.locator("#cloud").bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.5)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.7, box["y"] + box["height"] * 0.5, steps=5)
    page.mouse.up()
    after = page.evaluate(eye)
    turned = np.degrees(np.arctan2(after["y"], after["x"]) - np.arctan2(before["y"], before["x"]))
    assert abs(turned) > 5


def test_the_colour_cloud_turns_by_arrow_keys(page):
    page.locator("#cloud").scroll_into_view_if_needed()
    page.wait_for_selector("#cloud canvas")
    camera = "() => document.getElementById('cloud')._fullLayout.scene._scene.getCamera()"
    before = page.evaluate(camera)
    page.locator("#cloud").press("ArrowUp")
    page.wait_for_function(f"x => ({camera})().eye.x !== x", arg=before["eye"]["x"])
    a, b = (np.array(list(each["eye"].values())) for each in (before, page.evaluate(camera)))
    assert np.linalg.norm(b) == pytest.approx(np.linalg.norm(a))
    assert a @ b / (a @ a) == pytest.approx(np.cos(np.radians(10.0)), abs=1e-3)


def test_lights_that_a_method_found_are_drawn_beside_the_true_ones(page):
    page.locator("#lights").scroll_into_view_if_needed()
    page.wait_for_selector("#lights canvas")
    rings = page.evaluate("() => document.getElementById('lights').data.at(-1)")
    assert rings["marker"]["symbol"] == "circle-open"
    assert np.transpose([rings[axis] for axis in "xyz"]) == pytest.approx(1.15 * np.array([[0.0, 0.6, 0.8]]))


def test_the_relit_preview_follows_the_pointer(page):
    canvas = page.locator("#relit-truth")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    shades = []
    for share in (0.1, 0.9):
        page.mouse.move(box["x"] + box["width"] * share, box["y"] + box["height"] / 2)
        page.wait_for_timeout(100)
        pixel = "c => [...c.getContext('2d').getImageData(12, 32, 1, 1).data]"
        shades.append(canvas.evaluate(pixel)[0])
    assert shades[0] > shades[1] + 100  # the bump's left flank faces a light from the left


def test_nothing_in_a_config_or_a_message_becomes_markup(page):
    assert page.evaluate("() => window.hit") is None
    assert page.locator("#results b b, h2 b").count() == 0
    assert EVIL in page.locator("#filter-status").inner_text()


def test_nothing_is_wider_than_the_screen(browser, page, run: Path):
    fits(page, 1280)
    with opened(browser, run / "report/index.html", width=390) as narrow:
        fits(narrow, 390)


def fits(page, width: int) -> None:
    assert page.evaluate("() => document.documentElement.scrollWidth") == width
    labels = page.locator(".ticks span, .controls label, .thumbs figcaption").all()
    boxes = [box for box in (label.bounding_box() for label in labels) if box]
    assert len(boxes) > 5
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)


def test_results_are_filtered_by_verdict_and_the_word_does_not_rest_on_the_colour(page):
    page.locator("#filter-verdict").select_option("failed")
    assert column(page, "picture") == ["bump · linear"]
    assert column(page, "verdict")[0].startswith("✗ failed")
    page.locator("#filter-verdict").select_option("doubtful")
    assert len(column(page, "verdict")) == 1
    page.locator("#filter-verdict").select_option("")


def look_at_the_failed(page) -> None:
    """Show the result that failed in the inspector."""
    anchor = page.locator("tr[data-verdict='failed'] a").get_attribute("data-look")
    page.locator(f"a[data-look='{anchor}']").first.click()
    page.wait_for_selector(f"#inspector[data-shows='{anchor}']")


def test_the_inspector_says_the_verdict_why_and_what_to_do(page):
    look_at_the_failed(page)
    told = page.locator("#look-verdict").inner_text()
    for word in ("failed", "Why: the colours say too little", "What to do: choose a region where the surface turns"):
        assert word in told
    page.locator("a[data-look='picture-1-2']").first.click()
    page.wait_for_selector("#inspector[data-shows='picture-1-2']")
    assert "✓ trust" in page.locator("#look-verdict").inner_text()


def test_the_read_out_gives_the_stated_error_beside_the_true_one(page):
    at_a_pixel(page, "picture-1-3")
    assert page.locator("#read-stated").inner_text() == "1.000°"


def test_doubtful_pixels_are_hatched_until_the_box_is_cleared(page):
    look_at_the_failed(page)  # it declines every pixel
    source = "() => document.getElementById('panes').data[0].source"
    with_stripes = page.evaluate(source)
    page.get_by_label("hatch doubtful pixels").uncheck()
    page.wait_for_selector("#inspector[data-hatched='false']")
    assert page.evaluate(source) != with_stripes
    page.get_by_label("hatch doubtful pixels").check()
    page.wait_for_selector("#inspector[data-hatched='true']")
    assert page.evaluate(source) == with_stripes


CONTRAST = """() => {
  const light = (text) => { const [r, g, b] = text.match(/[\\d.]+/g).map((v) => { v /= 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = (e) => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor; if (!/, 0\\)$/.test(c)) return c; } return "rgb(255, 255, 255)"; };
  const places = [...document.querySelectorAll("h1, h2, figcaption, p, td, th, a, dt, dd, label, .badge, .status, summary, li")].filter((e) => e.innerText && e.checkVisibility());
  return Math.min(...places.map((e) => { const [a, b] = [light(getComputedStyle(e).color), light(ground(e))].sort((x, y) => y - x); return (a + 0.05) / (b + 0.05); }));
}"""  # noqa: E501


@pytest.fixture(scope="module")
def sheet(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one picture."""
    estimate, _ = read_estimate(run / "bump/linear/estimates", "least-squares")
    observation = read_observation(run / "bump/linear/observation.exr")
    return write_sheet(tmp_path_factory.mktemp("sheet"), "bump", "as rendered", observation, [estimate], ["A note."])


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("which", ["report", "sheet"])
def test_text_can_be_read_on_a_light_and_on_a_dark_page(browser, run: Path, sheet: Path, scheme: str, which: str):
    page = browser.new_page(color_scheme=scheme)
    page.goto((sheet if which == "sheet" else run / "report/index.html").as_uri())
    ground = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 150) == (scheme == "dark")
    assert page.evaluate(CONTRAST) >= 4.5  # WCAG 2.2, level AA
    page.close()


def test_on_a_phone_verdict_and_median_are_seen_without_scrolling_sideways(browser, run: Path):
    with opened(browser, run / "report/index.html", width=390) as narrow:
        for heading in ("verdict", "median", "mean"):
            box = narrow.locator("#results thead th").filter(has_text=re.compile(f"^{heading}")).bounding_box()
            assert box["x"] + box["width"] <= 390
        assert narrow.locator("#results tbody tr td.method .where").first.is_visible()


def test_twelve_results_are_printed_on_fewer_than_eight_pages(browser, tmp_path: Path):
    fabricate_run(tmp_path, {f"bump{n}/{t}": METHODS for n in range(2) for t in ("linear", "full")}, size=24)
    write_report(tmp_path)
    page = browser.new_page()
    page.goto((tmp_path / "report/index.html").as_uri())
    assert page.locator("#results tbody tr").count() == 12
    printed = page.pdf(format="A4")
    page.close()
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", printed)) < 8


def test_five_hundred_results_open_in_two_seconds_from_one_file(browser, run: Path, tmp_path: Path):
    item = next(item for item in read_items(run) if item.id == "bump/linear")
    scene = read_scene(item)
    cases = [score_case(scene, method) for method in METHODS]
    data = tmp_path / "data.json"
    data.write_text(viewer_json(scene, cases, [f"picture-1-{k}" for k in (1, 2, 3)]))
    small = tuple(thumbnail(panel.image, panel.title) for panel in core_panels(scene, cases[2]))
    sections = [
        ItemSection(
            item,
            f"picture-{n}",
            tuple(CaseSection(c.score.row, f"picture-{n}-{k}", "", small) for k, c in enumerate(cases, 1)),
            small[:1],
            data,
        )
        for n in range(1, 168)
    ]
    rows = [case.row for section in sections for case in section.cases]
    assert len(rows) > 500
    ((name, html),) = render_pages("many", rows, [], [], sections, {}, limit=PAGE_BYTES)
    (tmp_path / name).write_text(html)
    page = browser.new_page()
    page.goto((tmp_path / name).as_uri(), wait_until="load")
    timing = "() => performance.getEntriesByType('navigation')[0].loadEventEnd"
    page.wait_for_function(f"() => ({timing})() > 0")
    took = page.evaluate(timing)
    page.close()
    if took > 2000 and os.getloadavg()[0] > (os.cpu_count() or 1):
        pytest.skip(f"{took:.0f} ms on a machine that is busy with other work")
    assert took < 2000


def test_a_report_too_large_for_one_page_has_one_a_picture(browser, run: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("huesphere.eval.report.PAGE_BYTES", 1e5)
    monkeypatch.setattr("huesphere.eval.report.ALL_FIGURES_UP_TO", 0)
    monkeypatch.setattr("huesphere.eval.report.FIRST_AND_WORST", 0)
    write_report(run, ["weak-integrability"])
    report = run / "report"
    assert {p.name for p in (report / "pictures").iterdir()} == {"picture-1.html", "picture-2.html"}
    index = (report / "index.html").read_text()
    (link, *_) = re.findall(r'href="(pictures/[^"]+)"', index)
    path, _, anchor = link.partition("#")
    with opened(browser, report / path) as page:
        assert page.locator("#inspector").get_attribute("data-shows") == anchor
        page.get_by_role("link", name="after: bump/linear").click()
        page.wait_for_selector("#inspector[data-shows='picture-2-1']")
