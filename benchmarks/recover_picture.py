"""How long each method takes on one picture of a run folder.

Usage: python benchmarks/recover_picture.py run/mozart_5lights/linear/observation.exr
Prints tab-separated lines: method, status, seconds (best of five, kernels warm), peak memory of the process in MB.
"""

import resource
import sys
from pathlib import Path

from huesphere.recover.methods.table import METHODS
from huesphere.recover.run import recover_one
from huesphere.render.dataset import read_observation


def main() -> None:
    observation = read_observation(Path(sys.argv[1]))
    print("method", "status", "seconds", "MB", sep="\t")
    for method in METHODS:
        estimates = [recover_one(observation, method) for _ in range(5)]
        seconds = min(e.seconds for e in estimates)
        print(
            method,
            estimates[0].status,
            f"{seconds:.2f}",
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            sep="\t",
        )


if __name__ == "__main__":
    main()
