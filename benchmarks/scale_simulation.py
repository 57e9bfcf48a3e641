"""A sweep on a cluster, simulated from measured costs: how the work divides, and where more cores stop helping.

python benchmarks/scale_simulation.py [--cores 1,10,100,1000,10000] [--task 2.0] [--record]

A discrete-event simulation of the task graph: every worker (one core) starts a process, then takes tasks, a task being
one shape with all its lightings. What workers share is served one at a time, first come, first served: Dask's
scheduler, the lock of a manifest, the bandwidth of the file system. A worker dies at random, and its task is done again
after a new start. Computing times are log-normal about the measured mean. Three layouts:

one folder, array   every process writes to one run folder, and puts its items into one manifest under a lock
one folder, Dask    one client writes the manifest; workers wait for the scheduler only
a folder a part     every process has a run folder, and so a manifest, of its own (``--shard I/N --out part_I``)

Efficiency is the computing time of all tasks divided by cores × time until the last is finished.
"""

import argparse
import heapq
from dataclasses import dataclass, replace

import numpy as np
from record import record


@dataclass(frozen=True)
class Costs:
    """Measured by scale_cost.py, processor seconds of one core unless another unit is named."""

    task: float = 2.0  # a shape with all its lightings
    spread: float = 0.5  # standard deviation of the logarithm of that
    start: float = 6.0  # of a process: imports and compiled kernels
    items: int = 1  # of a task
    item_bytes: float = 0.24e6  # at 128², without layers and previews
    manifest_item: float = 4.3e-4  # putting items into a manifest, for each item that it has already
    scheduler: float = 4.6e-3  # a task of Dask
    bandwidth: float = 2e9  # bytes a second of the shared file system: an assumption
    failure: float = 1 / 30 / 86_400  # deaths of a worker, each second: one a month, an assumption


class Server:
    """Something that is used by one at a time, in the order in which they ask."""

    def __init__(self) -> None:
        self.free, self.busy = 0.0, 0.0

    def until(self, now: float, seconds: float) -> float:
        """When a use of this length ends that is asked for ``now``."""
        self.free = max(self.free, now) + seconds
        self.busy += seconds
        return self.free


def simulate(costs: Costs, cores: int, tasks: int, layout: str, *, there: int = 0, seed: int = 0) -> dict[str, float]:
    """Time until all tasks are finished (s), efficiency, deaths, and how busy each shared thing was (shares).

    ``there``: items that the manifest of a single folder has when the simulated stretch of a longer run begins.
    """
    rng = np.random.default_rng(seed)
    scheduler, lock, disk = Server(), Server(), Server()
    work = costs.task * np.exp(costs.spread * rng.standard_normal(tasks) - costs.spread**2 / 2)
    waiting, finished, deaths, last = list(range(tasks))[::-1], 0, 0, 0.0
    own = [0] * cores  # items in the manifest of each worker's own folder
    # Every event is (time, worker, what comes next, number of the task)
    events: list[tuple[float, int, str, int]] = [(costs.start, worker, "take", -1) for worker in range(cores)]
    heapq.heapify(events)
    while events:
        now, worker, what, task = heapq.heappop(events)
        if what == "take":
            if waiting:
                task = waiting.pop()
                ready = scheduler.until(now, costs.scheduler) if layout == "one folder, Dask" else now
                heapq.heappush(events, (ready, worker, "compute", task))
        elif what == "compute":
            dies = rng.exponential(1 / costs.failure)
            if dies < work[task]:
                deaths += 1
                waiting.append(task)
                heapq.heappush(events, (now + dies + costs.start, worker, "take", -1))
            else:
                heapq.heappush(events, (now + work[task], worker, "write", task))
        elif what == "write":
            end = disk.until(now, costs.items * costs.item_bytes / costs.bandwidth)
            heapq.heappush(events, (end, worker, "record", task))
        else:
            if layout == "one folder, array":
                end = lock.until(now, costs.manifest_item * (there + finished * costs.items))
            elif layout == "a folder a part":
                end = now + costs.manifest_item * own[worker]
                own[worker] += costs.items
            else:
                end = now
            finished += 1
            last = max(last, end)
            heapq.heappush(events, (end, worker, "take", -1))
    shares = {"scheduler": scheduler.busy / last, "lock": lock.busy / last, "disk": disk.busy / last}
    return {"seconds": last, "efficiency": work.sum() / (cores * last), "deaths": deaths} | shares


LAYOUTS = ("one folder, array", "one folder, Dask", "a folder a part")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cores", default="1,10,100,1000,10000")
    parser.add_argument("--tasks", type=int, default=200, help="for each core")
    parser.add_argument("--task", type=float, default=Costs.task, help="seconds of a task")
    parser.add_argument("--items", type=int, default=Costs.items, help="of a task")
    parser.add_argument("--most", type=int, default=200_000, help="tasks that are simulated at most")
    parser.add_argument("--record", action="store_true", help="append the efficiencies to results.tsv")
    arguments = parser.parse_args()
    costs = replace(Costs(), task=arguments.task, items=arguments.items)
    print("layout               cores   items/s  efficiency  scheduler   lock   disk  deaths")
    for layout in LAYOUTS:
        for cores in (int(text) for text in arguments.cores.split(",")):
            tasks = min(arguments.tasks * cores, arguments.most)
            got = simulate(costs, cores, tasks, layout)
            rate = tasks * costs.items / got["seconds"]
            print(
                f"{layout:18} {cores:7} {rate:9.3g} {got['efficiency']:11.2f} {got['scheduler']:10.2f} "
                f"{got['lock']:6.2f} {got['disk']:6.2f} {got['deaths']:7.0f}",
                flush=True,
            )
            if arguments.record:
                case = f"scale, simulated: {layout}, {cores} cores, {costs.task:g} s a task of {costs.items}"
                record(case, f"{got['efficiency']:.2f}", "efficiency", note=f"{rate:.3g} items a second")


if __name__ == "__main__":
    main()
