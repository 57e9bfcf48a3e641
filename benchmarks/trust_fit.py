"""Fit the weights of verdicts and stated errors to results of the trust bench: the JSON files of recover/trust.

python benchmarks/trust_fit.py RESULTS.jsonl … [--chosen RESULTS.jsonl …] [--write DATA] [--only hand|errors]

The credibility of an estimate is Π σ(a_f − Σ b_k x_k) over the factors f of ``recover.trust.factors``, b_k ≥ 0. It is
fitted by maximum likelihood to whether results are good, and checked by leaving out, in turn, a tenth of the pictures
with all their methods. Results of a choice of shapes, ``--chosen``, count less than those of a random one. DATA says in
words which results these are; the files that are written keep it.
"""

import argparse
import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from huesphere.recover.trust.evidence import Evidence
from huesphere.recover.trust.factors import FACTORS
from huesphere.recover.trust.stated_error import rotation_figures

TRUST = Path(__file__).parents[1] / "recover" / "trust"
WEIGHTS, ERROR_WEIGHTS = TRUST / "verdict_weights.json", TRUST / "stated_error_weights.json"
GOOD_MEDIAN_DEG, GOOD_MEAN_DEG = 8.0, 15.0
RIDGE = 1e-3  # of the weights, in units of the figures' standard deviations
FOLDS = 10
OTHER_METHODS_WEIGHT = 0.4  # of a result of a method other than auto, of which there are several for a picture
CHOSEN_WEIGHT = 0.3  # of a result of shapes that were chosen, such as more bowls than a random choice has
FACTOR = 1.4  # of the stated error over the typical one
PIXELS_RIDGE = 10.0  # of the regression over pixels
LEAST_ERROR_DEG = 1e-3
LEAST_ROTATION_DEG = 0.02  # smaller errors of a rotation count as this
ROTATION_RIDGE = 1.0  # of the regression of the rotation's error
ROTATION_FACTOR = 1.4  # of its stated error over the typical one
HAND_KNOWN_DEG = 12.0  # median error, of the estimate or its twin, up to which it is known which of them is right
MODELS = {  # of the two files, in words
    "verdict": "credibility = product over the factors of 1 / (1 + exp(sum of weight * figure - offset)), by maximum "
    "likelihood of good results; 'least': credibility from which a result is trusted",
    "stated error": "decimal logarithm of the error in degrees = sum of weight * figure, by regression; 'factor': of "
    "the stated error over the typical one",
}
LEAST = {"hand": 0.92, "others": 0.55}  # credibility from which a result is trusted
HAND_DATA = "; of the factor hand: "  # separates the data of the factor ``hand`` from that of the others
Row = dict[str, Any]


def read_rows(paths: list[Path]) -> list[Row]:
    """The results that have evidence and errors."""
    rows = [json.loads(line) for path in paths for line in path.read_text(encoding="utf-8").splitlines()]
    return [row for row in rows if row.get("median_deg") is not None and "pixels" in row]


def evidence_of(row: Row) -> Evidence:
    """The evidence that a line of results keeps."""
    return Evidence(**{k: float("inf") if v is None else v for k, v in row["diagnostics"]["trust"]["evidence"].items()})


class Model:
    """A product of some of the factors, with its unknowns in one vector."""

    def __init__(self, factors: list[str], evidence: list[Evidence]) -> None:
        self.factors = factors
        self.names = [(factor, name) for factor in factors for name in FACTORS[factor].figures(evidence[0])]
        self.factor = np.array([factors.index(factor) for factor, _ in self.names])
        X = self.figures(evidence)
        self.middle, self.scale = X.mean(axis=0), np.maximum(X.std(axis=0), 1e-6)

    def figures(self, evidence: list[Evidence]) -> np.ndarray:
        """(R, K) of R results."""
        return np.array([[v for name in self.factors for v in FACTORS[name].figures(e).values()] for e in evidence])

    def log_product(self, x: np.ndarray, X: np.ndarray) -> np.ndarray:
        """(R,) logarithm of the product; x holds the F offsets, then the K weights."""
        return self._log_factors(x, X).sum(axis=1)

    def _log_factors(self, x: np.ndarray, X: np.ndarray) -> np.ndarray:
        z = x[: len(self.factors)] - self._sum((X - self.middle) / self.scale * x[len(self.factors) :])
        return -np.logaddexp(0, -z)

    def _sum(self, terms: np.ndarray) -> np.ndarray:
        return np.stack([terms[:, self.factor == f].sum(axis=1) for f in range(len(self.factors))], axis=1)

    def fit(self, X: np.ndarray, good: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """The unknowns of maximum likelihood, with a ridge on the weights."""
        count, Z = len(self.factors), (X - self.middle) / self.scale

        def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
            z = x[:count] - self._sum(Z * x[count:])
            log_p = np.minimum(-np.logaddexp(0, -z).sum(axis=1), -1e-9)
            log_q = np.log(-np.expm1(log_p))
            value = -(weight * np.where(good, log_p, log_q)).sum() / weight.sum()
            by_log_p = weight * np.where(good, -1.0, np.exp(log_p - log_q)) / weight.sum()
            by_z = by_log_p[:, None] / (1 + np.exp(z))
            by_b = -(by_z[:, self.factor] * Z).sum(axis=0)
            gradient = np.concatenate([by_z.sum(axis=0), by_b + 2 * RIDGE * x[count:]])
            return float(value + RIDGE * (x[count:] ** 2).sum()), gradient

        start = np.concatenate([np.full(count, 4.0), np.full(len(self.names), 0.5)])
        bounds = [(-2.0, 8.0)] * count + [(0.0, 6.0)] * len(self.names)
        return np.asarray(minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x)

    def record(self, x: np.ndarray) -> dict[str, Any]:
        """The factors' offsets and weights, of the figures as they are."""
        count = len(self.factors)
        b = x[count:] / self.scale
        out: dict[str, Any] = {}
        for f, factor in enumerate(self.factors):
            own = [k for k in range(len(self.names)) if self.factor[k] == f]
            offset = x[f] + sum(b[k] * self.middle[k] for k in own)
            out[factor] = {"offset": round(float(offset), 4)}
            out[factor]["weights"] = {self.names[k][1]: round(float(b[k]), 4) for k in own}
        return out


@dataclass
class Task:
    """What a model is fitted to: which results, which of them are good, and how much each counts."""

    model: Model
    rows: np.ndarray  # (R,) bool
    good: np.ndarray  # (R,) bool


class Results:
    """The results that are fitted to: their evidence and errors, and which of them make up a fold."""

    def __init__(self, rows: list[Row], chosen: list[Row]) -> None:
        self.rows = rows = rows + chosen
        self.evidence = [evidence_of(row) for row in rows]
        self.weight = np.array([1.0] * (len(rows) - len(chosen)) + [CHOSEN_WEIGHT] * len(chosen))
        self.median, self.mean, self.flipped = (
            np.array([row[key] for row in rows]) for key in ("median_deg", "mean_deg", "flipped_median_deg")
        )
        self.method = np.array([row["method"] for row in rows])
        self.weight *= np.where(self.method == "auto", 1.0, OTHER_METHODS_WEIGHT)
        self.ok = np.array([row["status_unjudged"] == "ok" for row in rows])
        self.right = self.median < self.flipped  # convex or concave
        pictures = np.unique([row["file"] for row in rows], return_inverse=True)[1]
        self.fold = np.random.default_rng(0).permutation(pictures.max() + 1)[pictures] % FOLDS

    def tasks(self) -> tuple[Task, Task]:
        """Convex or concave; and all else."""
        either = np.minimum(self.median, self.flipped)
        good = (either < GOOD_MEDIAN_DEG) & ~(self.right & (self.mean > GOOD_MEAN_DEG))
        others = [name for name in FACTORS if name != "hand"]
        return (
            Task(Model(["hand"], self.evidence), either < HAND_KNOWN_DEG, self.right),
            Task(Model(others, self.evidence), np.ones(len(self.rows), bool), good),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("--write", metavar="DATA", help=f"write {WEIGHTS.name} and {ERROR_WEIGHTS.name}")
    parser.add_argument("--chosen", type=Path, nargs="+", default=[], help="results of shapes that were chosen")
    parser.add_argument("--only", choices=("hand", "errors"), help="write the factor hand alone, or the stated errors")
    asked = parser.parse_args()
    results = Results(read_rows(asked.results), read_rows(asked.chosen))
    factors, left_out = fit_factors(results)
    for method in sorted(set(results.method)):
        _table(results, method, left_out)
    for k in np.argsort(-left_out.prod(axis=1)):
        if results.ok[k] and results.median[k] > 10 and (left_out[k] > list(LEAST.values())).all():
            errors = f"{results.median[k]:.1f} / {results.mean[k]:.1f}, flipped {results.flipped[k]:.1f}"
            print(f"  {results.method[k]} {results.rows[k]['file']}  {errors}  {left_out[k].round(2)}")
    errors_by = fit_errors(results)
    print(json.dumps(factors, indent=1), json.dumps(errors_by, indent=1), sep="\n")
    if asked.write:
        if asked.only == "hand":
            _write_hand(asked.write, factors["hand"])
        if asked.only is None:
            write_weights(WEIGHTS, asked.write, "verdict", "'least'", {"least": LEAST, "factors": factors})
        if asked.only != "hand":
            write_weights(ERROR_WEIGHTS, asked.write, "stated error", "both factors", errors_by)


def _write_hand(data: str, found: dict[str, Any]) -> None:
    """Put the factor ``hand``, and what is asked of credibilities, in the place of those in the file of weights."""
    kept = json.loads(WEIGHTS.read_text(encoding="utf-8"))
    kept |= {"data": f"{kept['data'].split(HAND_DATA)[0]}{HAND_DATA}{data}", "least": LEAST}
    kept["factors"]["hand"] = found
    WEIGHTS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


def write_weights(path: Path, data: str, model: str, by_hand: str, found: dict[str, Any]) -> None:
    """Write a file of weights, with where they come from."""
    origin = {"script": "benchmarks/trust_fit.py", "data": data, "model": MODELS[model], "by hand": by_hand}
    path.write_text(json.dumps(origin | found, indent=1) + "\n", encoding="utf-8")


def fit_factors(results: Results) -> tuple[Row, np.ndarray]:
    """(offset and weights of every factor; credibility (R, 2) of hand and others, by weights from other pictures)."""
    weight = results.weight
    left_out, found = np.zeros((len(results.rows), 2)), {}
    for number, task in enumerate(results.tasks()):
        X = task.model.figures(results.evidence)
        for fold in range(FOLDS):
            own, rest = task.rows & (results.fold != fold), results.fold == fold
            left_out[rest, number] = task.model.log_product(
                task.model.fit(X[own], task.good[own], weight[own]), X[rest]
            )
        found |= task.model.record(task.model.fit(X[task.rows], task.good[task.rows], weight[task.rows]))
    return found, np.exp(left_out)


def fit_errors(results: Results) -> Row:
    """Weights of the stated error's figures: regression of log error over pixels of results that may be trusted."""
    some = results.ok & results.right & (results.median < HAND_KNOWN_DEG)
    samples = [np.array(row["pixels"]) for row, take in zip(results.rows, some) if take and row["pixels"]]
    names = results.rows[0]["figures"]
    pixels = np.concatenate(samples)
    y, X = np.log10(np.clip(pixels[:, 0], LEAST_ERROR_DEG, 180.0)), pixels[:, 1:]
    b = np.linalg.solve(X.T @ X + PIXELS_RIDGE * np.eye(X.shape[1]), X.T @ y)
    stated = FACTOR * 10 ** (X @ b)
    for low, high in itertools.pairwise((0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 90)):
        own = (stated >= low) & (stated < high)
        if own.any():
            shares = [float((pixels[own, 0] <= times * stated[own]).mean()) for times in (1, 2, 10)]
            print(f"  stated {low}–{high}°: {own.sum()} pixels, within once, twice, ten times: {np.round(shares, 3)}")
    found: Row = {"factor": FACTOR, "weights": {name: round(float(value), 4) for name, value in zip(names, b)}}
    return found | {"rotation": fit_rotation(results)}


def fit_rotation(results: Results) -> Row:
    """Weights of the rotation's stated error: regression of its logarithm, checked by leaving out a tenth in turn."""
    known = np.minimum(results.median, results.flipped) < HAND_KNOWN_DEG
    told = np.array([row.get("rotation_deg") is not None for row in results.rows])
    own = np.flatnonzero(
        known & told & results.ok & np.array([e.rotation_deg >= LEAST_ERROR_DEG for e in results.evidence])
    )
    figures = [rotation_figures(results.evidence[k]) for k in own]
    X = np.array([list(one.values()) for one in figures])
    y = np.log10(np.clip([results.rows[k]["rotation_deg"] for k in own], LEAST_ROTATION_DEG, 180.0))

    def weights_of(some: np.ndarray) -> np.ndarray:
        ridge = ROTATION_RIDGE * np.eye(X.shape[1])
        return np.asarray(np.linalg.solve(X[some].T @ X[some] + ridge, X[some].T @ y[some]))

    left_out = np.concatenate(
        [(y - X @ weights_of(results.fold[own] != fold))[results.fold[own] == fold] for fold in range(FOLDS)]
    )
    before = y - X[:, list(figures[0]).index("rotation_deg")]
    print(
        f"rotation, {len(own)} results: log10 of true over typical error, left out: rms {np.std(left_out):.2f}, "
        f"over what methods state: median {np.median(before):.2f}, rms {np.std(before):.2f}"
    )
    names = list(figures[0])
    b = weights_of(np.ones(len(own), bool))
    return {"factor": ROTATION_FACTOR, "weights": {name: round(float(value), 4) for name, value in zip(names, b)}}


def _table(results: Results, method: str, left_out: np.ndarray) -> None:
    """Print what different thresholds would let pass."""
    own = results.ok & (results.method == method)
    median, mean, good = results.median, results.mean, own & (results.median < 3)
    print(
        f"{method}, ok before the verdict: {own.sum()}, {good.sum()} under 3°, {(own & (median > 10)).sum()} over 10°"
    )
    for hand in (0.85, 0.9, 0.95):
        for others in (0.5, 0.6, 0.7, 0.8):
            passed = own & (left_out[:, 0] > hand) & (left_out[:, 1] > others)
            counts = f"{passed.sum()} pass, {(passed & (median > 10)).sum()} over 10°, {(passed & (mean > 15)).sum()}"
            kept = passed[good].mean() if good.any() else float("nan")
            print(f"  hand {hand}, others {others}: {counts} mean over 15°; {kept:.0%} of those under 3°")


if __name__ == "__main__":
    main()
