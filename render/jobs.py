"""Applies a function to independent tasks: in this process, in several processes, or on a Dask cluster.

The function is called with (task, progress, log). Results are yielded as they are ready, in any order. If a worker
process dies, another worker tries its task once more.
"""

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from huesphere.configs.threads import one_blas_thread
from huesphere.render.backend import THREADS
from huesphere.render.cluster import on_cluster
from huesphere.render.tasks import Function, Log, Lost, Progress, Results, Shares

SECONDS_BETWEEN = 0.2  # least time between two reports of progress by one worker
TRIES = 2  # of a task whose worker dies
# Signals that people, shells and job schedulers send to processes that are to end
ASKED_TO_END = (signal.SIGTERM, signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGTERM))
# Environment variables that set the number of threads of numerical libraries
LIBRARY_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class _OnOneThread:
    """A function whose linear algebra runs on one thread. Unlike a closure it can be sent to other processes."""

    function: Function

    def __call__(self, task: Any, progress: Progress, log: Log) -> Any:
        with one_blas_thread():
            return self.function(task, progress, log)


def each(
    function: Function, tasks: Sequence[Any], *, jobs: int, scheduler: str | None, progress: Progress, log: Log
) -> Results:
    """Apply ``function`` to all ``tasks``; yields (number of the task, result or Lost) as results are ready.

    ``jobs``: number of processes; ``scheduler``: address of a Dask cluster, which is used instead. ``progress`` is
    called with the share of all work that is done, and ``log`` with lines for the user. In every worker linear algebra
    runs on one thread (``configs.threads``). An error that ``function`` raises is raised here and ends the work.
    Raises InputError if the scheduler does not answer or its workers have other versions, and Unfinished if it is lost.
    """
    function = _OnOneThread(function)
    if scheduler is not None:
        return on_cluster(function, tasks, scheduler, progress, log)
    if min(jobs, len(tasks)) > 1:
        return _in_processes(function, tasks, min(jobs, len(tasks)), progress, log)
    return _here(function, tasks, progress, log)


def add_options(parser: Any, default: int | None = 1) -> None:
    """Add the options `--jobs` and `--scheduler`, which are the same for every command, to ``parser``."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=_positive, default=default, metavar="N", help="processes on this machine")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster: tcp://host:8786")


def _positive(text: str) -> int:
    """The whole number from 1 that an option gives. Raises argparse.ArgumentTypeError."""
    import argparse

    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"got {text}, expected a whole number from 1")
    return int(text)


# ---- this process --------------------------------------------------------------------------------------------------


def _here(function: Function, tasks: Sequence[Any], progress: Progress, log: Log) -> Results:
    """``each`` in this process."""
    shares = Shares(len(tasks), progress)
    for number, task in enumerate(tasks):

        def part(share: float, what: str, number: int = number) -> None:
            shares.put(number, share, what)

        yield number, function(task, part, log)
        part(1.0, "")


# ---- processes of this machine -------------------------------------------------------------------------------------


@dataclass
class _Worker:
    """A worker process."""

    process: Any
    pipe: Any  # this process's end of the connection to the worker
    task: int | None = None  # number of its current task; None: it is free


def _in_processes(function: Function, tasks: Sequence[Any], jobs: int, progress: Progress, log: Log) -> Results:
    """``each`` in several processes of this machine."""
    shares = Shares(len(tasks), progress)
    pool = _Pool(function, tasks, jobs)
    try:
        while pool.unfinished:
            pool.hand_out()
            for number, kind, content in pool.messages():
                if kind == "progress":
                    shares.put(number, *content)
                elif kind == "log":
                    log(content)
                elif kind == "error":
                    raise content
                else:
                    yield number, content
                    shares.put(number, 1.0, "")
    finally:
        pool.kill()


class _Pool:
    """The worker processes with their current tasks, and the tasks that wait for a worker."""

    def __init__(self, function: Function, tasks: Sequence[Any], jobs: int) -> None:
        self.function, self.tasks, self.jobs = function, tasks, jobs
        self.waiting = list(reversed(range(len(tasks))))
        self.tries = [0] * len(tasks)
        self.workers: list[_Worker] = []

    @property
    def busy(self) -> list[_Worker]:
        return [worker for worker in self.workers if worker.task is not None]

    @property
    def unfinished(self) -> bool:
        return bool(self.waiting or self.busy)

    def hand_out(self) -> None:
        """Start workers while tasks wait, up to the number of jobs, and send a task to each free worker."""
        while self.waiting and len(self.workers) < self.jobs:
            self.workers.append(_start(self.function, max(1, (os.cpu_count() or 1) // self.jobs)))
        for worker in self.workers:
            if worker.task is None and self.waiting:
                worker.task = self.waiting.pop()
                self.tries[worker.task] += 1
                with contextlib.suppress(BrokenPipeError):  # the worker died: `messages` will find its pipe closed
                    worker.pipe.send(self.tasks[worker.task])

    def messages(self) -> Iterator[tuple[int, str, Any]]:
        """Wait for messages of busy workers, and yield (number of the task, kind, content) of each.

        Kinds are "progress", "log", "error", and "done", whose content is the result, or Lost if a worker died each
        time that the task was tried. If a worker dies and its task may be tried again, the task goes back to those that
        wait, and there is no message.
        """
        busy = self.busy
        multiprocessing.connection.wait([worker.pipe for worker in busy])
        for worker in busy:
            for kind, content in _received(worker):
                number = worker.task
                assert number is not None
                if kind in ("done", "dead"):
                    worker.task = None
                if kind == "dead":
                    self.workers.remove(worker)
                    if self.tries[number] < TRIES:
                        self.waiting.append(number)
                    else:
                        yield number, "done", content
                else:
                    yield number, kind, content

    def kill(self) -> None:
        """End all worker processes."""
        for worker in self.workers:
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()


def _start(function: Function, threads: int) -> _Worker:
    """Start a worker process whose libraries use ``threads`` threads."""
    # A new process, not a fork: this process may have run threads of numba or BLAS, which do not survive a fork.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(function, theirs), daemon=True)
    with _environment({name: str(threads) for name in (*LIBRARY_THREADS, THREADS)}):
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _received(worker: _Worker) -> Iterator[tuple[str, Any]]:
    """(kind, content) of each message in the pipe of a worker; if the worker has died, the last is "dead" and Lost.

    At "done" the caller sets the worker's ``task`` to None before it asks for more, which ends the messages.
    """
    try:
        while worker.task is not None and worker.pipe.poll():
            yield worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join()
        code = worker.process.exitcode
        how = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
        yield "dead", Lost(f"the worker died ({how})", ended=bool(code and -code in ASKED_TO_END))


def _serve(function: Function, pipe: Any) -> None:
    """The main function of a worker process: receives tasks and sends messages until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which then kills its workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    last = 0.0

    def send(kind: str, content: Any) -> None:
        try:
            pipe.send((kind, content))
        except OSError:
            _parent_is_gone()

    def progress(share: float, what: str) -> None:
        nonlocal last
        if time.monotonic() - last > SECONDS_BETWEEN:
            last = time.monotonic()
            send("progress", (share, what))

    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            _parent_is_gone()
        try:
            kind, content = "done", function(task, progress, lambda line: send("log", line))
        except Exception as error:
            kind, content = "error", _portable(error)
        send(kind, content)


def _end_with_parent() -> None:
    """End this worker as soon as its parent has ended, however that was."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        _parent_is_gone()


def _parent_is_gone() -> NoReturn:
    """End this worker at once. What it had in hand is as if it had been killed: no item is recorded as failed."""
    os._exit(1)


def _portable(error: Exception) -> Exception:
    """``error`` itself if it can be pickled, otherwise a RuntimeError with its traceback as text."""
    import pickle
    import traceback

    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:  # errors of other libraries may not be picklable
        return RuntimeError("".join(traceback.format_exception(error)))


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables within the block, and restore them after it."""
    kept = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in kept.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
