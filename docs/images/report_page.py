"""The README's picture of the report: the page's inspector at 1280 pixels, by headless Chromium.

python docs/images/report_page.py RUN_DIR CASE      CASE: the anchor of a result on the page, such as picture-2-2

The picture that is kept is made by

    render --config mozart_5lights.yaml --out run
    evaluate run
    python docs/images/report_page.py run picture-2-2
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

TARGET = Path(__file__).with_suffix(".png")
MARGIN = 16  # pixels of the page shown around the inspector


def main(run: Path, case: str) -> None:
    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        page = browser.new_page(viewport={"width": 1280, "height": 1400})
        page.goto(f"{(run / 'report/index.html').resolve().as_uri()}#{case}")
        page.wait_for_selector(f"#inspector[data-shows='{case}']")
        page.locator("#cloud-space").select_option("axes")
        page.locator("#inspector").scroll_into_view_if_needed()
        page.wait_for_selector("#lights canvas")
        box = page.locator("#panes").bounding_box()
        page.mouse.move(box["x"] + 0.875 * box["width"], box["y"] + 0.55 * box["height"])
        page.wait_for_timeout(2000)  # drawing in space is slow without a graphics card
        shown = page.locator("#inspector").bounding_box()
        clip = {key: shown[key] - MARGIN for key in "xy"} | {
            key: shown[key] + 2 * MARGIN for key in ("width", "height")
        }
        shot = Image.open(io.BytesIO(page.screenshot(clip=clip)))
        browser.close()
    shot.convert("RGB").save(TARGET, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
