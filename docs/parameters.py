"""Write docs/parameters.md: every tuned number of recovery, what it does at half and at twice it, and learned weights.

Usage: python docs/parameters.py. The numbers come from the records in ``recover/*/parameters.py``, their effects from
the newest rows of ``benchmarks/results.tsv`` that ``benchmarks/recover_sensitivity.py`` wrote.
"""

import re
from pathlib import Path

from huesphere.recover.parameters import described, learned, learned_files, records

DOCS = Path(__file__).resolve().parent
RESULTS = DOCS.parent / "benchmarks" / "results.tsv"
HEAD = """\
# Tuned numbers

<!-- Written by docs/parameters.py. Edit the records in recover/*/parameters.py, not this page. -->

These are the {count} numbers of `recover` whose value experience chose and another value would change results. Each
has its unit, its meaning and what set it. Mathematical constants, guards, tolerances and sizes of work are
constants in the code, where they are used.

*Effect*: the largest median turn of the normals, in degrees, when the number is halved / doubled, over eleven runs
of methods on six small scenes (`benchmarks/recover_sensitivity.py`). A share over one half is changed by its
distance from 1. No effect there does not mean that the number is useless: few scenes reach some of the branches.
"""

LEARNED = """\
## Learned weights

These were fitted to data, or chosen together, many at once: each in a JSON file, with the script that did it.
"""


def page() -> str:
    """The text of docs/parameters.md."""
    measured = effects()
    parts = [HEAD.format(count=sum(len(described(record)) for record in records().values()))]
    for name, record in records().items():
        package = type(record).__module__.split(".")[-2]
        parts += [f"## {package}: `{name}`", ""]
        for field, value, unit, meaning, origin in described(record):
            parts += [f"`{field}` = `{value}` {_prose(unit)}", f": {_prose(meaning)} *Set by: {_prose(origin)}.*"]
            if (name, field) in measured:
                parts[-1] += f" *Effect: {measured[name, field]}.*"
            parts.append("")
    parts.append(LEARNED)
    for file in learned_files():
        found = learned(file)
        by_hand = f" Set by hand: {_prose(found['by hand'])}." if "by hand" in found else ""
        parts += [
            f"`recover/{file}`, by `{found['script']}`",
            f": {_prose(found['model'][0].upper() + found['model'][1:])}. *Data: {_prose(found['data'])}.*{by_hand}",
            "",
        ]
    return "\n".join(parts)


def effects() -> dict[tuple[str, str], str]:
    """Of each number that was measured, its newest effect, as "turn at half / turn at twice"."""
    found = {}
    for line in RESULTS.read_text(encoding="utf-8").splitlines():
        cells = line.split("\t")
        said = re.match(r"sensitivity, (\w+)\.(\w+):", cells[3]) if len(cells) > 4 else None
        if said:
            found[said[1], said[2]] = cells[4]
    return found


def _prose(text: str) -> str:
    """``text`` as Markdown: code stays code, and no sign is taken for markup."""
    return re.sub(r"([|*$<])", r"\\\1", text.replace("``", "`"))


def main() -> None:
    (DOCS / "parameters.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
