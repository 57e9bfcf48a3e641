"""The card of a data set, README.md: what it holds, how it was made, how it is divided, and its licence.

It says nothing of the number of samples, which each shard's own record has, so that every machine that writes a part
of the data set writes the same card.
"""

import json
from dataclasses import dataclass, field
from typing import Any

from huesphere.eval.datasets.sample import CONTENTS, USUAL
from huesphere.eval.datasets.splits import Shares

ABOUT = "Spectral pictures of shapes with known surface normals, rendered by huesphere."
FRAME = """\
Frame of all vectors: x right, y up, z toward the camera; row 0 of an image is at the top. Values of `rgb` are linear
camera responses with full scale 1. `mask` is true on the object; off it, normals, depth and albedo are NaN.
`principal_point` is the camera's, in pixels from the picture's middle."""
READING = {
    "webdataset": 'import webdataset as wds\n\nsamples = wds.WebDataset("train-00000-of-00001.tar").decode()\n'
    'for sample in samples:\n    rgb, mask = sample["rgb.npy"], sample["mask.npy"]',
    "huggingface": 'from datasets import load_dataset\n\ndata = load_dataset("DIR").with_format("numpy")\n'
    'rgb, mask = data["train"][0]["rgb"], data["train"][0]["mask"]',
    "hdf5": 'import h5py\n\nwith h5py.File("train-00000-of-00001.h5") as file:\n'
    '    for config in file.values():\n        for item in config.values():\n            rgb = item["rgb"][:]',
}


@dataclass(frozen=True)
class About:
    """What the owner says of a data set, and what goes into it."""

    title: str
    license: str  # an SPDX identifier or an address
    contents: tuple[str, ...] = USUAL
    shares: Shares = field(default_factory=Shares)
    shards: int = 1  # of each split

    @property
    def license_url(self) -> str:
        return self.license if "://" in self.license else f"https://spdx.org/licenses/{self.license}"


def card_text(about: About, kind: str, versions: dict[str, Any]) -> str:
    """The text of README.md. ``kind``: a key of READING; ``versions``: of the packages that rendered, by name."""
    head = {"license": about.license.lower(), "pretty_name": about.title, "tags": ["surface-normals", "synthetic"]}
    if "://" in about.license:
        head |= {"license": "other", "license_name": "see license_link", "license_link": about.license}
    lines = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    holds = ["rgb (H, W, 3): the picture, with the camera's noise", "mask (H, W)", *map(CONTENTS.get, about.contents)]
    shares = about.shares
    return "\n".join(
        [
            "---",
            *lines,
            "---",
            f"# {about.title}\n",
            f"{ABOUT}\n",
            "## What a sample holds\n",
            *(f"- {line}" for line in holds),
            f"\n{FRAME}\n",
            "## Splits\n",
            f"Of the shapes {shares.train:.4g} train, {shares.validation:.4g} validation, {shares.test:.4g} test, by",
            "SHA-256 of the shape's parameters: no shape is in two splits. Each split has up to",
            f"{about.shards} files; beside each, a JSON file names its items and has its SHA-256.\n",
            "## Where it comes from\n",
            "Rendered, not photographed: colours are integrals over wavelength, normals those of the rendered mesh.",
            "Made by " + ", ".join(f"{name} {version}" for name, version in sorted(versions.items())) + ".\n",
            "## Licence\n",
            f"{about.license} ({about.license_url}), as stated by those who made the data set.\n",
            "## Reading\n",
            f"```python\n{READING[kind]}\n```",
            "",
        ]
    )
