"""A run folder as an RO-Crate 1.1: its manifest in the words of schema.org, for repositories and data catalogues.

    python -m huesphere.render.crate run --name "Bowls under gels" --license https://spdx.org/licenses/CC-BY-4.0

Owner and licence of the data are known only to those who made them, so both are asked for and have no default.
"""

import datetime
import json
from pathlib import Path
from typing import Any

from huesphere.configs.commandline import Parser, finish, say
from huesphere.configs.own_folder import write_text
from huesphere.render.manifest import read_manifest

FILE = "ro-crate-metadata.json"
KINDS = {".exr": "image/x-exr", ".yaml": "application/yaml", ".png": "image/png"}
ABOUT = "Spectral pictures with known surface normals, rendered by huesphere; its docs/format.md explains each field."


def describe_run(run: Path, *, name: str, license_url: str, date: datetime.date) -> dict[str, Any]:
    """The crate's JSON-LD: one Dataset for each finished item, one File with size and sha256 for each of its files."""
    manifest = read_manifest(run)
    done = [item for item in manifest["items"] if item["status"] == "done"]
    graph: list[dict[str, Any]] = [
        {
            "@id": FILE,
            "@type": "CreativeWork",
            "about": {"@id": "./"},
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
        },
        {
            "@id": "./",
            "@type": "Dataset",
            "name": name,
            "description": ABOUT,
            "license": {"@id": license_url},
            "datePublished": date.isoformat(),
            "hasPart": [{"@id": f"{item['id']}/"} for item in done] + [{"@id": "manifest.json"}],
        },
        {"@id": "manifest.json", "@type": "File", "encodingFormat": "application/json", "name": "manifest"},
    ]
    for item in done:
        files = item["files"]
        parts = [{"@id": file["path"]} for file in files]
        graph.append({"@id": f"{item['id']}/", "@type": "Dataset", "name": item["id"], "hasPart": parts})
        graph += [_file(file) for file in files]
    return {"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph}


def _file(file: dict[str, Any]) -> dict[str, Any]:
    entity = {"@id": file["path"], "@type": "File", "name": Path(file["path"]).name, "sha256": file["sha256"]}
    entity["encodingFormat"] = KINDS.get(Path(file["path"]).suffix, "application/octet-stream")
    return entity | ({"contentSize": str(file["bytes"])} if "bytes" in file else {})


def _command() -> None:
    parser = Parser(
        prog="python -m huesphere.render.crate", description="write ro-crate-metadata.json into a run folder"
    )
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR")
    parser.add_argument("--license", required=True, metavar="URL")
    parser.add_argument("--name", required=True)
    arguments = parser.parse_args()
    crate = describe_run(
        arguments.run_dir, name=arguments.name, license_url=arguments.license, date=datetime.date.today()
    )
    write_text(arguments.run_dir / FILE, json.dumps(crate, indent=1, ensure_ascii=False) + "\n")
    say(f"{arguments.run_dir / FILE}: {len(crate['@graph'])} entities")


if __name__ == "__main__":
    finish(_command)
