"""The robust shell fit against public robust regressions: seconds, and how low each gets the criterion.

Two of them are R packages. On Debian: apt-get install r-base-core r-cran-mass r-cran-robustbase. scikit-learn and
statsmodels take part where they can be imported; the project does not need them.

python benchmarks/recover_peers.py [pixels …] [--record]

All fit ρᵀCρ = 1 without intercept, Eqs. (9)–(10), to the same colours: noise 0.3 %, 30 % of them on the shell of what
one light does not reach. Seconds are of the fit alone, the design matrix given to the peers and made by ours. A peer
that at a tenth of the pixels was on its way to more than two minutes is not run: its seconds are ten times those, for
all of them are at least linear in the pixels, and are marked as extrapolated; its criteria stay unknown.
"""

import importlib.util
import subprocess
import sys
import tempfile
import time

import numpy as np
from record import record

from huesphere.recover.ellipsoid.fit import least_median_of_squares
from huesphere.recover.geometry.quadratic import design, elements_of

LONGEST = 120.0  # s, of one fit of a peer
R_CODE = """
arguments <- commandArgs(TRUE); n <- as.integer(arguments[2])
x <- matrix(readBin(arguments[3], "double", 6 * n), n); y <- rep(1, n); set.seed(1)
seconds <- system.time(z <- switch(arguments[1],
  lqs = coef(MASS::lqs(x, y, intercept = FALSE, method = "lms")),
  ltsReg = robustbase::ltsReg(x, y, intercept = FALSE, alpha = 0.5, mcd = FALSE)$raw.coefficients))[["elapsed"]]
cat(sprintf("%.17g", c(seconds, z)), "\\n")
"""


def colours(count: int, noise: float = 3e-3, seed: int = 5) -> np.ndarray:
    """(N, 3) float32: what all of four lights reach, and, of every ten, three that the first does not."""
    rng = np.random.default_rng(seed)
    radius, turn = np.sqrt(rng.uniform(0, 0.9, count)), rng.uniform(0, 2 * np.pi, count)
    n = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=-1)
    A = np.array([[0.30, 0.10, 1.0], [-0.25, 0.20, 1.0], [0.05, -0.30, 1.0], [-0.05, 0.05, 1.0]])
    B = np.array([[0.30, 0.10, 0.05], [0.05, 0.30, 0.10], [0.05, 0.10, 0.30], [0.10, 0.08, 0.06]])
    shaded = n @ A.T
    shaded[rng.uniform(size=count) < 0.3, 0] = 0.0
    return (shaded @ B + noise * rng.standard_normal((count, 3))).astype(np.float32)


def criteria(M: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """(median of r² as lqs takes it, sum of the ⌊(N + 7) / 2⌋ least r² as ltsReg does)."""
    squared = (M @ z - 1) ** 2
    median, half = (len(M) + 1) // 2, (len(M) + 7) // 2
    squared.partition((median - 1, half - 1))
    return float(squared[median - 1]), float(squared[:half].sum())


def by_r(which: str, M: np.ndarray) -> tuple[float, np.ndarray]:
    with tempfile.NamedTemporaryFile() as file:
        M.T.tofile(file.name)  # R reads a matrix column by column
        words = ["Rscript", "-e", R_CODE, which, str(len(M)), file.name]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    seconds, *z = map(float, said.split())
    return seconds, np.array(z)


def by_ransac(M: np.ndarray) -> tuple[float, np.ndarray]:
    from sklearn.linear_model import LinearRegression, RANSACRegressor

    # Its own threshold is the spread of the right side, which here is none: the true spread of r is told to it.
    model = RANSACRegressor(LinearRegression(fit_intercept=False), residual_threshold=0.05, random_state=0)
    started = time.perf_counter()
    model.fit(M, np.ones(len(M)))
    return time.perf_counter() - started, np.asarray(model.estimator_.coef_)


def by_rlm(M: np.ndarray) -> tuple[float, np.ndarray]:
    from statsmodels.api import RLM

    started = time.perf_counter()
    fitted = RLM(np.ones(len(M)), M).fit()
    return time.perf_counter() - started, np.asarray(fitted.params)


def by_us(rgb: np.ndarray) -> tuple[float, np.ndarray]:
    """The best of four: the first may compile."""
    seconds = []
    for _ in range(4):
        started = time.perf_counter()
        C = least_median_of_squares(rgb)
        seconds.append(time.perf_counter() - started)
    return min(seconds), elements_of(C)


def main(sizes: list[int], keep: bool) -> None:
    peers = {"MASS::lqs": lambda M: by_r("lqs", M), "robustbase::ltsReg": lambda M: by_r("ltsReg", M)}
    for name, module, fit in (("RANSACRegressor", "sklearn", by_ransac), ("RLM", "statsmodels", by_rlm)):
        if importlib.util.find_spec(module) is None:
            print(f"{module} is not installed: {name} is left out")
        else:
            peers[name] = fit
    last: dict[str, tuple[int, float]] = {}
    for count in sizes:
        rgb = colours(count)
        M = design(rgb)
        results = {"ours": by_us(rgb)}
        note = "median r² {:.6g}, LTS objective {:.6g}".format
        lines = [("ours", results["ours"][0], note(*criteria(M, results["ours"][1])))]
        for name, fit in peers.items():
            before, took = last.get(name, (count, 0.0))
            expected = took * count / before
            if expected > LONGEST:
                lines.append((name, expected, f"EXTRAPOLATED from {took:.3g} s at {before} pixels"))
                continue
            seconds, z = fit(M)
            last[name] = (count, seconds)
            lines.append((name, seconds, note(*criteria(M, z))))
        for name, seconds, text in lines:
            text += f"; ours is {seconds / lines[0][1]:.3g} times as fast" if name != "ours" else ""
            if keep:
                record(f"shell fit, {count} pixels, {name}", seconds, "s", note=text)
            else:
                print(f"{count} {name}: {seconds:.4g} s, {text}", flush=True)


if __name__ == "__main__":
    try:
        subprocess.run(["Rscript", "-e", "library(MASS); library(robustbase)"], capture_output=True, check=True)
    except (FileNotFoundError, subprocess.CalledProcessError):
        sys.exit("recover_peers: needs R: apt-get install r-base-core r-cran-mass r-cran-robustbase")
    main([int(a) for a in sys.argv[1:] if a.isdigit()] or [10_000, 100_000, 1_000_000], "--record" in sys.argv)
