"""Run the studies and keep their results as pages of the documentation: python docs/studies.py [NAME]…"""

import shutil
import sys
from pathlib import Path

from huesphere.configs.study import load_study, packaged_studies
from huesphere.eval.studies.run import run_study

DOCS = Path(__file__).parent


def keep(folder: Path, into: Path) -> None:
    """Copy a study's Markdown and CSV, and its figures as WebP, which are small enough to be kept."""
    from PIL import Image

    shutil.rmtree(into, ignore_errors=True)
    (into / "figures").mkdir(parents=True)
    text = (folder / "study.md").read_text(encoding="utf-8")
    for path in sorted((folder / "figures").glob("*.png")):
        with Image.open(path) as image:
            image.convert("RGB").save(into / "figures" / f"{path.stem}.webp", quality=82, method=6)
        text = text.replace(f"figures/{path.name}", f"figures/{path.stem}.webp")
    (into / "study.md").write_text(text, encoding="utf-8")
    shutil.copy(folder / "results.csv", into / "results.csv")


def main() -> None:
    names = sys.argv[1:] or [name.removesuffix(".yaml") for name in packaged_studies()]
    for name in names:
        folder = DOCS.parent / "build" / f"study-{name}"
        found, _ = run_study(load_study(name), folder, jobs=2, log=lambda line: print(line, flush=True))
        if not found.sections:  # its data are not here
            print(f"{name}: {found.answer[0]}")
            continue
        keep(folder, DOCS / "studies" / name)
        print(f"{name}: {found.seconds:.0f} s")


if __name__ == "__main__":
    main()
