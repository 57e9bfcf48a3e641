"""The citation file has what the Citation File Format 1.2.0 requires, and is of the version that is installed."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
# Keys of a citation, and of a reference, as the schema of CFF 1.2.0 has them: those required, and others that we use.
REQUIRED, USED = (
    {"cff-version", "message", "title", "authors"},
    {"type", "version", "license", "abstract", "keywords", "references"},
)
OF_REFERENCE, USED_OF_REFERENCE = {"type", "title", "authors"}, {"institution", "number", "year"}
PERSON, ENTITY = {"given-names", "family-names", "affiliation", "orcid", "email"}, {"name"}


def check_authors(authors: list[dict[str, str]]) -> None:
    assert authors
    for author in authors:
        assert set(author) <= PERSON or set(author) == ENTITY, author
        assert all(isinstance(value, str) and value for value in author.values())


def test_the_citation_has_the_keys_that_its_format_requires_and_no_unknown_ones():
    assert REQUIRED <= set(CITATION) <= REQUIRED | USED
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] in ("software", "dataset")
    check_authors(CITATION["authors"])
    assert len(set(CITATION["keywords"])) == len(CITATION["keywords"])
    for reference in CITATION["references"]:
        assert OF_REFERENCE <= set(reference) <= OF_REFERENCE | USED_OF_REFERENCE
        assert set(reference["institution"]) == ENTITY
        assert isinstance(reference["year"], int)
        check_authors(reference["authors"])


def test_version_and_licence_are_those_of_the_package_and_of_the_entry_to_paste():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert CITATION["version"] == project["version"]
    assert CITATION["license"] == project["license"]
    page = (ROOT / "docs/walkthroughs.md").read_text(encoding="utf-8")
    assert re.search(r"version = \{(.*?)\}", page)[1] == project["version"]
    for reference in CITATION["references"]:
        assert reference["title"] in " ".join(page.split())
        assert reference["number"] in page
