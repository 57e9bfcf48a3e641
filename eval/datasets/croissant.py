"""Croissant metadata (MLCommons, version 1.0) of a folder of Parquet shards: files with sha256, splits, and columns.

    python -m huesphere.eval.datasets.croissant DIR

makes croissant.json again from the files in DIR, after shards of another machine were put beside its own.
"""

import json
from pathlib import Path
from typing import Any

from huesphere.configs.commandline import Parser, finish, path_argument, say
from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside, write_text
from huesphere.configs.regular_file import RECORD_BYTES, read_text
from huesphere.eval.datasets.splits import SPLITS

FILE = "croissant.json"
CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
TYPES = {"bool": "sc:Boolean", "float": "sc:Float", "string": "sc:Text"}


def write_croissant(folder: Path) -> Path:
    """Write croissant.json for the Parquet shards in ``folder``/data; returns its path.

    Title, licence and date are those in the records beside the shards. Raises InputError if there are no shards.
    """
    records = []
    for path in sorted(inside(folder, "data").glob("*.json")):
        try:
            records.append(json.loads(read_text(path, most=RECORD_BYTES, follow=False)))
        except (OSError, ValueError) as error:
            raise InputError("not a record of a shard", got=type(error).__name__, where=path) from None
    if not records:
        raise InputError("no Parquet shards", expected="data/*.parquet with a JSON file beside each", where=folder)
    path = inside(folder, FILE)
    write_text(path, json.dumps(_metadata(folder, records), indent=1, ensure_ascii=False) + "\n")
    return path


def _metadata(folder: Path, records: list[dict[str, Any]]) -> dict[str, Any]:
    import pyarrow.parquet as pq

    files, sets = [], []
    for split in SPLITS:
        of_split = [record for record in records if record["split"] == split]
        for record in of_split:
            files.append(
                {
                    "@type": "cr:FileObject",
                    "@id": record["file"],
                    "name": record["file"],
                    "contentUrl": f"data/{record['file']}",
                    "encodingFormat": "application/x-parquet",
                    "contentSize": f"{record['bytes']} B",
                    "sha256": record["sha256"],
                }
            )
        if of_split:
            schema = pq.read_schema(inside(folder, f"data/{of_split[0]['file']}"))
            sets += [_record_set(split, record["file"], schema) for record in of_split]
    about = records[0]
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": about["title"],
        "description": about["description"],
        "license": about["license"],
        "version": "1.0.0",
        "distribution": files,
        "recordSet": sets,
    }


def _record_set(split: str, file: str, schema: Any) -> dict[str, Any]:
    """The record set of one shard, with a field for each column."""
    name = f"{split}/{file.removesuffix('.parquet')}"
    fields = []
    for column in schema:
        kind, repeated = column.type, False
        while hasattr(kind, "value_type"):
            kind, repeated = kind.value_type, True
        fields.append(
            {
                "@type": "cr:Field",
                "@id": f"{name}/{column.name}",
                "name": column.name,
                "dataType": TYPES[str(kind)],
                "source": {"fileObject": {"@id": file}, "extract": {"column": column.name}},
            }
            | ({"repeated": True} if repeated else {})
        )
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "description": f"samples of {split}", "field": fields}


def _command() -> None:
    parser = Parser(prog="python -m huesphere.eval.datasets.croissant", description="write croissant.json of a folder")
    parser.add_argument("folder", metavar="DIR", type=path_argument)
    say(str(write_croissant(parser.parse_args().folder)))


if __name__ == "__main__":
    finish(_command)
