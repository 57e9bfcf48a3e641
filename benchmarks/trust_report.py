"""Tables and figures of benchmarks/trust.py: verdicts against true errors, and stated errors against true ones."""

import json
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from record import record

Row = dict[str, Any]
Figure = tuple[str, float, str, str]  # what, how much, unit, note

BINS_DEG = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)  # edges between bins of the stated error
GOOD_DEG, BAD_DEG, BAD_MEAN_DEG = 3.0, 10.0, 15.0
ALIKE = 0.5  # the hand is wrong where the flip has less than this share of the error
VERDICTS = ("trust", "doubtful", "failed")


def report(path: Path, *, recorded: bool) -> None:
    """Print everything of a file of results; ``recorded``: append the figures to results.tsv too."""
    lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    rows = list({(row["file"], row["method"]): row for row in lines}.values())  # the last line of each
    for method in sorted({row["method"] for row in rows}):
        own = [row for row in rows if row["method"] == method]
        print(f"Method {method}: {len(own)} results\n")
        for part in (confusion, calibration, reasons, failures):
            print(part(own))
        for family in [*sorted({row["family"] for row in own}), "all"]:
            for what, value, unit, note in figures([row for row in own if family in (row["family"], "all")]):
                case = f"trust, {method}, {family}: {what}"
                if recorded:
                    record(case, value, unit, note=note)
                else:
                    print(f"{case}: {value:.4g} {unit} {note}")
        print()


def median_of(row: Row) -> float:
    """Median error, degrees; NaN without normals."""
    return float(row.get("median_deg", np.nan))


def is_wrong_hand(row: Row) -> bool:
    """Whether the normals are those of the surface turned inside out."""
    return median_of(row) > GOOD_DEG and row["flipped_median_deg"] < ALIKE * median_of(row)


def is_turned(row: Row) -> bool:
    """Whether the normals are right but for a rotation or reflection that all share, other than the hand."""
    return median_of(row) > GOOD_DEG and row["aligned_median_deg"] < ALIKE * median_of(row) and not is_wrong_hand(row)


# ---- tables ---------------------------------------------------------------------------------------------------------


def table(names: list[str], lines: Iterable[list[str]]) -> str:
    """Columns of text, the first aligned to the left."""
    cells = [names, *lines]
    widths = [max(len(line[i]) for line in cells) for i in range(len(names))]
    rows = [
        [line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))] for line in cells
    ]
    return "\n".join("  ".join(row) for row in rows) + "\n"


def confusion(rows: list[Row]) -> str:
    """Numbers of pictures by verdict and median error, in groups: families, shapes of scenes, kinds of breakers."""
    classes: list[Callable[[float], bool]] = [
        lambda e: e < GOOD_DEG,
        lambda e: GOOD_DEG <= e <= BAD_DEG,
        lambda e: e > BAD_DEG,
        lambda e: np.isnan(e),
    ]
    names = ["group", "n"]
    names += [f"{v} {e}" for v in VERDICTS for e in (f"<{GOOD_DEG:g}", f"–{BAD_DEG:g}", f">{BAD_DEG:g}", "none")]
    names += ["median", "of trust"]
    lines = []
    for group, some in _groups(rows):
        line = [group, str(len(some))]
        for stated in VERDICTS:
            own = [median_of(row) for row in some if row["verdict"] == stated]
            line += [str(sum(map(test, own)) or "·") for test in classes]
        for listed in (some, [row for row in some if row["verdict"] == "trust"]):
            known = [median_of(row) for row in listed if not np.isnan(median_of(row))]
            line.append(f"{np.median(known):.2f}" if known else "–")
        lines.append(line)
    return "Verdict against median error, degrees\n" + table(names, lines)


def _groups(rows: list[Row]) -> list[tuple[str, list[Row]]]:
    """The families, then the kinds of each."""
    families = sorted({row["family"] for row in rows})
    whole = [(family, [row for row in rows if row["family"] == family]) for family in families]
    kinds = sorted({(row["family"], row["kind"]) for row in rows})
    return whole + [(f"{f}/{k}", [row for row in rows if (row["family"], row["kind"]) == (f, k)]) for f, k in kinds]


def calibration(rows: list[Row]) -> str:
    """Shares of pixels within the stated error, within twice, beyond ten times, by bins of the stated error."""
    edges = [0.0, *BINS_DEG, np.inf]
    text = ""
    for family in sorted({row["family"] for row in rows}):
        for stated in ("trust", "doubtful"):
            own = [
                r["calibration"]
                for r in rows
                if r["family"] == family and r["verdict"] == stated and "calibration" in r
            ]
            if not own:
                continue
            counts = np.sum(own, axis=0)
            lines = [
                [f"{edges[i]:g}–{edges[i + 1]:g}", str(n), *(f"{c / n:.1%}" for c in rest)]
                for i, (n, *rest) in enumerate(counts.tolist())
                if n
            ]
            total = counts.sum(axis=0)
            lines.append(["all", str(total[0]), *(f"{c / total[0]:.1%}" for c in total[1:])])
            names = ["stated, degrees", "pixels", "within", "within twice", "beyond ten"]
            text += f"Stated error, {family}, verdict {stated} ({len(own)} pictures)\n" + table(names, lines) + "\n"
    return text


def reasons(rows: list[Row]) -> str:
    """Errors by the reason of the pixels' normals, of pictures whose verdict is trust."""
    names, lines = ["reason", "pixels", "mean error", "mean stated"], []
    for family in sorted({row["family"] for row in rows}):
        own = [r.get("reasons", {}) for r in rows if r["family"] == family and r["verdict"] == "trust"]
        for reason in sorted({name for found in own for name in found}):
            values = np.array([found[reason] for found in own if reason in found], dtype=float)
            n = values[:, 0]
            known = np.isfinite(values[:, 2])
            stated = np.sum((n * values[:, 2])[known]) / max(1, n[known].sum())
            mean = np.sum(n * values[:, 1]) / n.sum()
            lines.append([f"{family} {reason}", f"{n.sum():.0f}", f"{mean:.2f}", f"{stated:.2f}"])
    return "Errors by reason, verdict trust, degrees\n" + table(names, lines)


def failures(rows: list[Row]) -> str:
    """The pictures whose verdict does not fit their error, and those without a result."""
    trusted = [row for row in rows if row["verdict"] == "trust"]
    lists: dict[str, list[Row]] = {
        f"trust, median over {BAD_DEG:g}°": [r for r in trusted if median_of(r) > BAD_DEG],
        f"trust, mean over {BAD_MEAN_DEG:g}°, median not over {BAD_DEG:g}°": [
            r for r in trusted if r.get("mean_deg", 0) > BAD_MEAN_DEG and not median_of(r) > BAD_DEG
        ],
        f"median under {GOOD_DEG:g}°, not trust": [
            r for r in rows if median_of(r) < GOOD_DEG and r["verdict"] != "trust"
        ],
        "timeout or crash": [r for r in rows if r["status"] in ("timeout", "crash")],
    }
    text = ""
    for what, some in lists.items():
        text += f"{what}: {len(some)}\n"
        for row in sorted(some, key=lambda r: (r["family"], r["kind"], r["seed"])):
            text += f"  {_line(row)}\n"
    return text


def _line(row: Row) -> str:
    if "median_deg" not in row:
        return f"{row['file']}  {row['status']}  {row['message']}"
    hand = "  wrong hand" if is_wrong_hand(row) else "  turned" if is_turned(row) else ""
    error = f"median {row['median_deg']:.1f} mean {row['mean_deg']:.1f} flipped {row['flipped_median_deg']:.1f}"
    stated = row["stated_median_deg"]
    told = f"aligned {row['aligned_median_deg']:.1f} stated {float('nan') if stated is None else stated:.2g}"
    return f"{row['file']}  {row['verdict']}  {row['status']}  {error} {told}{hand}"


# ---- figures --------------------------------------------------------------------------------------------------------


def figures(rows: list[Row]) -> list[Figure]:
    """The figures of some results, all of one method."""
    trusted = [row for row in rows if row["verdict"] == "trust"]
    good = [row for row in rows if median_of(row) < GOOD_DEG]
    bad = [row for row in rows if median_of(row) > BAD_DEG]
    found = [
        _share(f"trust and median over {BAD_DEG:g}°", trusted, lambda r: median_of(r) > BAD_DEG, "trusted"),
        _share(
            f"trust and mean over {BAD_MEAN_DEG:g}°", trusted, lambda r: r.get("mean_deg", 0) > BAD_MEAN_DEG, "trusted"
        ),
        _share(f"of medians under {GOOD_DEG:g}°, trust", good, lambda r: r["verdict"] == "trust", "such results"),
        _share(f"of medians over {BAD_DEG:g}°, not trust", bad, lambda r: r["verdict"] != "trust", "such results"),
        _share(f"median under {GOOD_DEG:g}°", rows, lambda r: median_of(r) < GOOD_DEG, "results"),
        _share("convex or concave right, of trust", trusted, lambda r: not is_wrong_hand(r), "trusted"),
        _share("turned as a whole, of trust", trusted, is_turned, "trusted"),
    ]
    told = [r for r in trusted if r.get("stated_median_deg") is not None and median_of(r) > 0]
    ratios = [r["stated_median_deg"] / median_of(r) for r in told]
    if ratios:
        low, middle, high = np.percentile(ratios, [10, 50, 90])
        found.append(("stated over true median, of trust", float(middle), "ratio", f"10–90 %: {low:.2g}–{high:.2g}"))
    counts = np.sum([r["calibration"] for r in trusted if "calibration" in r] or [[[0] * 4]], axis=(0, 1))
    for name, count in zip(
        ("within stated", "within twice stated", "beyond ten times stated"), counts[1:], strict=True
    ):
        if counts[0]:
            found.append((f"pixels {name}, of trust", float(count / counts[0]), "share", f"of {counts[0]} pixels"))
    seconds = [row["seconds"] for row in rows if "seconds" in row]
    if seconds:
        found.append(("seconds, median", float(np.median(seconds)), "s", f"90 %: {np.percentile(seconds, 90):.3g} s"))
    ends = Counter(row["status"] for row in rows)
    for status in ("timeout", "crash"):
        found.append((status, float(ends[status]), "results", f"of {len(rows)}"))
    return [figure for figure in found if not np.isnan(figure[1])]


def _share(what: str, rows: list[Row], test: Callable[[Row], bool], of: str) -> Figure:
    """The share of ``rows`` that pass; NaN of none."""
    count = sum(map(test, rows))
    return what, count / len(rows) if rows else float("nan"), "share", f"{count} of {len(rows)} {of}"
