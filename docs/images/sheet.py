"""A sheet of the pictures of a run's items, with their names: python docs/images/sheet.py RUN OUT.png [COLUMNS]

For each item its developed picture where it has one, otherwise its preview. The documentation's pictures of new shapes
and cameras are made by it from the shipped configs.
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw

from huesphere.render.dataset import open_run

EDGE, TITLE = 240, 16  # pixels: width of a picture, height of its name
FILES = ("developed.jpg", "developed.png", "preview.png")


def sheet(run: Path, columns: int) -> Image.Image:
    """The pictures of ``run`` side by side, ``columns`` in a row."""
    tiles = []
    for item in open_run(run):
        path = next(item.folder / name for name in FILES if (item.folder / name).is_file())
        picture = Image.open(path).convert("RGB")
        tile = Image.new("RGB", (EDGE, EDGE * picture.height // picture.width + TITLE), "white")
        tile.paste(picture.resize((EDGE, tile.height - TITLE), Image.Resampling.BICUBIC), (0, TITLE))
        ImageDraw.Draw(tile).text((3, 2), _short(item.id.rpartition("/")[0]), fill="black")
        tiles.append(tile)
    rows = -(-len(tiles) // columns)
    whole = Image.new("RGB", (EDGE * columns, tiles[0].height * rows), "white")
    for number, tile in enumerate(tiles):
        whole.paste(tile, (number % columns * EDGE, number // columns * tile.height))
    return whole


def _short(name: str) -> str:
    """The part of an item's name that differs within a run: what follows the config's own name."""
    return name.partition("-")[2] or name


if __name__ == "__main__":
    sheet(Path(sys.argv[1]), int((sys.argv[3:] or ["4"])[0])).save(sys.argv[2], optimize=True)
