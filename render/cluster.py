"""Applies a function to independent tasks on the workers of a Dask cluster (``render.jobs.each``).

The cluster may go away while it works, and its workers may have another version of this program: both end the work in
one line. What was finished is in the run folder then.
"""

import importlib.metadata
import logging
import os
import platform
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from huesphere.configs.errors import InputError, Unfinished
from huesphere.render.backend import THREADS
from huesphere.render.tasks import Function, Log, Lost, Progress, Results, Shares

SECONDS_TO_ANSWER = 10  # time-out of the connection to a scheduler
SECONDS_WITHOUT_WORKER = 60.0  # that a cluster may have no worker: a lost one is started again in seconds
SECONDS_TO_LOOK_AGAIN = 0.05  # between two looks at what is finished
KEPT = "what was finished is kept, and the same command goes on"
# Packages whose versions the files depend on, or without which a worker cannot read its tasks
SAME_VERSIONS = ("huesphere", "mitsuba", "drjit", "numpy", "scipy")
# Held while a worker works on a task: even a worker with several threads does one task at a time, because the numerical
# libraries use its threads.
_ONE_TASK = threading.Lock()


def on_cluster(function: Function, tasks: Sequence[Any], address: str, progress: Progress, log: Log) -> Results:
    """``each`` on the Dask cluster of the scheduler at ``address``.

    Raises InputError if it does not answer or a worker has other versions, and Unfinished if the scheduler is lost.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'huesphere[cluster]'", got=address) from None
    _require_an_answer(address)
    for name in ("distributed", "distributed.client", "distributed.comm", "distributed.utils", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # failures are reported by this module's messages
    shares = Shares(len(tasks), progress)
    client: Any = None
    try:
        client = Client(address, timeout=SECONDS_TO_ANSWER, set_as_default=False)
        _wait_for_a_worker(client, address)
        _require_same_versions(client, address)
        wanted = _versions()
        numbers = {client.submit(_remote, function, task, wanted, pure=False): n for n, task in enumerate(tasks)}
        for future in _finished(as_completed(list(numbers), loop=client.loop), client, address):
            number = numbers.pop(future)
            try:
                lines, result = future.result()
            except KilledWorker:
                lines, result = [], Lost("the workers that tried it died")
            for line in lines:
                log(line)
            yield number, result
            shares.put(number, 1.0, "")
    except (InputError, Unfinished):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None and not _is_lost(error):
            raise  # of a task: a full disk
        raise Unfinished(_how_it_ended(error, address)) from None
    finally:
        if client is not None:
            with suppress(Exception):  # a client without a scheduler cannot say goodbye
                client.close(timeout=SECONDS_TO_ANSWER)


def _wait_for_a_worker(client: Any, address: str) -> None:
    """Raise InputError if the cluster has no worker, and none comes in time."""
    try:
        client.wait_for_workers(1, timeout=SECONDS_WITHOUT_WORKER)
    except TimeoutError:
        found = f"none within {SECONDS_WITHOUT_WORKER:g} s"
        raise InputError("--scheduler: workers", got=found, expected="at least one", where=address) from None


def _finished(futures: Any, client: Any, address: str) -> Iterator[Any]:
    """Futures as they are finished. Raises Unfinished when the cluster has had no worker for too long."""
    last_seen = time.monotonic()
    while not futures.is_empty():
        batch = futures.next_batch(block=False)
        yield from batch
        if batch:
            last_seen = time.monotonic()
            continue
        time.sleep(SECONDS_TO_LOOK_AGAIN)
        if time.monotonic() - last_seen > SECONDS_WITHOUT_WORKER:
            if not client.scheduler_info(n_workers=-1)["workers"]:
                raise Unfinished(f"the cluster at {address} has no worker left: {KEPT}")
            last_seen = time.monotonic()


def _is_lost(error: Exception) -> bool:
    """Whether an error says that the connection to the scheduler is gone."""
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"CommClosedError", "CancelledError", "FutureCancelledError", "TimeoutError"})


def _how_it_ended(error: Exception, address: str) -> str:
    """One line on an error of the cluster itself."""
    if _is_lost(error) or isinstance(error, ConnectionError):
        return f"the scheduler at {address} is gone: {KEPT}"
    text = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    return f"a worker of {address} could not do its task ({text}): {KEPT}"


def _versions() -> dict[str, str]:
    """Versions of Python and of SAME_VERSIONS in this process."""
    found = {"python": ".".join(platform.python_version_tuple()[:2])}
    for package in SAME_VERSIONS:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found


def _require_same_versions(client: Any, address: str) -> None:
    """Raise InputError if a worker of the cluster has other versions than this process.

    Only functions of Python's own library are sent, so that a worker without this program can answer.
    """
    for package, ours in _versions().items():
        if package == "python":
            answers = client.run(platform.python_version_tuple, on_error="return")
            found = {where: ".".join(v[:2]) if isinstance(v, tuple) else "unknown" for where, v in answers.items()}
        else:
            answers = client.run(importlib.metadata.version, package, on_error="return")
            found = {where: v if isinstance(v, str) else "not installed" for where, v in answers.items()}
        for where, theirs in found.items():
            if theirs != ours:
                raise _other_version(package, theirs, ours, where, address)


def _other_version(package: str, theirs: str, ours: str, where: str, address: str) -> InputError:
    return InputError(
        f"--scheduler: the worker {where} has another version of {package}", got=theirs, expected=ours, where=address
    )


def _require_an_answer(address: str) -> None:
    """Raise InputError if nothing listens at ``address``; Dask's client itself would try again in the background."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise InputError("--scheduler", got=address, expected="an address such as tcp://host:8786")
    try:
        socket.create_connection((host, port), timeout=SECONDS_TO_ANSWER).close()
    except (OSError, UnicodeError) as error:
        raise InputError(f"--scheduler: nobody answers there ({error})", got=address) from None


def _remote(function: Function, task: Any, wanted: dict[str, str]) -> tuple[list[str], Any]:
    """Do one task on a worker of a cluster, with all threads of the worker; returns (logged lines, result).

    Raises InputError if the versions here are not the ``wanted`` ones: the worker may have come after the others.
    """
    import numba
    from distributed import get_worker

    worker = get_worker()
    for package, theirs in _versions().items():
        if wanted.get(package) not in (None, theirs):
            raise _other_version(package, theirs, wanted[package], worker.address, "--scheduler")
    threads = worker.state.nthreads
    lines: list[str] = []
    with _ONE_TASK:
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
        os.environ[THREADS] = str(threads)
        return lines, function(task, lambda share, what: None, lines.append)
