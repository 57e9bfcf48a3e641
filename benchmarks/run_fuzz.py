"""Thousands of odd and bad inputs: python benchmarks/run_fuzz.py [--cases 10000] [--kind mesh] [--first SEED]

Each case runs under a time limit, in a process that may die of it. Prints the seed of each that went wrong;
`--kind mesh --first 123 --cases 1` runs that one again.
"""

import argparse
import collections
import multiprocessing
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

from record import record

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
SHARES = {"config": 0.3, "depth map": 0.1, "mesh": 0.1, "picture": 0.08, "run folder": 0.08, "render": 0.02}
SHARES |= {"any picture": 0.08, "mask": 0.05, "normal map": 0.05, "spectrum": 0.06, "no file": 0.03}
SHARES |= {"hostile run folder": 0.05}
MOST_MEMORY = 2 * 2**30  # bytes of address space that a case may take beyond what the program itself has


def run(kind: str, seeds: range, answers) -> None:
    """Run cases and send (kind, seed, what went wrong or None, seconds)."""
    from fuzz import in_time
    from fuzz_cases import CASES

    warnings.simplefilter("ignore")
    if kind != "render":  # the renderer reserves address space that it never uses
        _limit_memory()
    for seed in seeds:
        answers.put((kind, seed, "started", 0.0))
        started = time.monotonic()
        wrong = None
        with tempfile.TemporaryDirectory() as folder:
            try:
                with in_time():
                    CASES[kind](random.Random(f"{kind} {seed}"), Path(folder))
            except Exception as error:
                wrong = f"{type(error).__name__}: {error}\n" + "".join(traceback.format_exception(error)[-4:])
        answers.put((kind, seed, wrong, time.monotonic() - started))


def _limit_memory() -> None:
    """Let this process take MOST_MEMORY more than it has: a case that needs more ends in a MemoryError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def fuzz(kind: str, first: int, count: int) -> list[tuple[int, str]]:
    """(seed, what went wrong) of the cases of one kind; a process that dies is one of them, and the rest go on."""
    context = multiprocessing.get_context("spawn")
    wrong, at, slowest = [], first, 0.0
    while at < first + count:
        answers = context.SimpleQueue()
        process = context.Process(target=run, args=(kind, range(at, first + count), answers))
        process.start()
        running = at
        while process.is_alive() or not answers.empty():
            if answers.empty():
                time.sleep(0.01)
                continue
            _, seed, message, seconds = answers.get()
            if message == "started":
                running = seed
                continue
            slowest, at = max(slowest, seconds), seed + 1
            if message is not None:
                wrong.append((seed, message))
        process.join()
        if process.exitcode:
            wrong.append((running, f"the process died: {process.exitcode}"))
            at = running + 1
    print(f"{kind}: {count} cases, {len(wrong)} wrong, slowest {slowest:.1f} s", flush=True)
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--kind", choices=SHARES)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--record", action="store_true", help="a line in results.tsv")
    arguments = parser.parse_args()
    started = time.monotonic()
    counts = {k: round(s * arguments.cases) for k, s in SHARES.items()}
    if arguments.kind:
        counts = {arguments.kind: arguments.cases}
    total = 0
    for kind, count in counts.items():
        wrong = fuzz(kind, arguments.first, count)
        total += len(wrong)
        shown = collections.Counter()
        for seed, message in wrong:
            last = message.splitlines()[0][:60]
            shown[last] += 1
            if shown[last] <= 2:
                print(f"--- {kind} {seed}: {message}", flush=True)
    if arguments.record:
        note = f"{sum(counts.values())} cases in {time.monotonic() - started:.0f} s: " + ", ".join(
            map(str, counts.items())
        )
        record("fuzz: cases with a traceback, a hang or a wrong answer", total, "", note=note)
    sys.exit(1 if total else 0)


if __name__ == "__main__":
    main()
