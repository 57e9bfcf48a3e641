"""From configs to items on disk: groups of one geometry, rendered here or elsewhere, and the manifest kept."""

import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.schema import RunConfig
from huesphere.render.group import render_group
from huesphere.render.item import entry_there, write_failure
from huesphere.render.jobs import Log, Lost, Progress, each
from huesphere.render.manifest import put_items, remove_remains
from huesphere.render.plan import Group, Plan, Shard, make_plan

MOST_LINES = 8  # items that are named one by one
SECONDS_BETWEEN = 1.0  # between two writings of the manifest; the records of items have what it lacks


@dataclass(frozen=True)
class Orders:
    """How items are to be made: the options of `render`. Only ``engine`` has an influence on the pictures."""

    engine: str = "auto"  # "transport", "reference", or "auto": transport where it can run
    overwrite: bool = False
    retry_failed: bool = False
    jobs: int = 1
    scheduler: str | None = None
    shard: Shard | None = None
    left_out: tuple[str, ...] = ()  # files that are not written: of OPTIONAL_FILES


def render_configs(
    configs: Sequence[RunConfig], run: Path, *, progress: Progress, log: Log, **options: Any
) -> list[str]:
    """Render the items of ``configs`` into ``run``; returns their ids. Items that are there already are kept.

    ``options`` are the fields of Orders.

    Configs that differ only in what relighting may change share one trace, whose error is that of the worst of them.
    ``log`` is called with lines for the user. Raises InputError for bad input and for items made by another config;
    Unfinished, at the end, if items of a sweep failed: they are recorded, and the others are done.
    """
    orders = Orders(**options)
    if run.exists() and not run.is_dir():
        raise InputError("--out", got="a file", expected="a folder", where=run)
    plan = make_plan(
        configs,
        run,
        overwrite=orders.overwrite,
        retry_failed=orders.retry_failed,
        shard=orders.shard,
        left_out=orders.left_out,
    )
    _log_kept(plan, log)
    if run.is_dir():
        remove_remains(run)
    fresh = _carry_out(plan, run.resolve(), orders, progress, log, lone=len(configs) == 1)
    failed = [*plan.failed, *(entry for entry in fresh if entry["status"] == "failed")]
    missing = len(plan.ids) - len(plan.there) - len(plan.failed) - len(fresh)
    if failed:
        hint = "" if not plan.failed else f"; {len(plan.failed)} of them before (--retry-failed tries them again)"
        raise Unfinished(
            f"{len(failed)} of {len(plan.ids)} items failed{hint}; the first, {failed[0]['id']}: {failed[0]['error']}"
        )
    if missing:
        raise Unfinished(
            f"{missing} of {len(plan.ids)} items are not made, because their workers were told to end; "
            "what was finished is kept, and the same command goes on"
        )
    return list(plan.ids)


def render_config(config: RunConfig, run: Path, *, progress: Progress, log: Log, **options: Any) -> list[str]:
    """`render_configs` of one."""
    return render_configs([config], run, progress=progress, log=log, **options)


def _log_kept(plan: Plan, log: Log) -> None:
    for entries, what in ((plan.there, "already there"), (plan.failed, "failed before")):
        ids = [str(entry["id"]) for entry in entries]
        for item in ids if len(ids) <= MOST_LINES else [f"{len(ids)} items"]:
            log(f"{item}: {what}")


def _carry_out(
    plan: Plan, run: Path, orders: Orders, progress: Progress, log: Log, *, lone: bool
) -> list[dict[str, Any]]:
    """Render the groups of ``plan``; returns the entries of what was made, which the manifest has even after errors."""
    function = partial(render_group, run=run, engine=orders.engine, left_out=orders.left_out, lone=lone)
    made: list[dict[str, Any]] = []
    unwritten = [*plan.there, *plan.failed]
    last = time.monotonic()
    try:
        with closing(
            each(function, plan.groups, jobs=orders.jobs, scheduler=orders.scheduler, progress=progress, log=log)
        ) as results:
            for number, result in results:
                if isinstance(result, Lost):
                    result = _what_is_left(run, plan.groups[number], result)
                made += result
                unwritten += result
                if time.monotonic() - last > SECONDS_BETWEEN:
                    put_items(run, unwritten)
                    unwritten, last = [], time.monotonic()
    finally:
        if run.is_dir():
            remove_remains(run)
            put_items(run, unwritten)
    return made


def _what_is_left(run: Path, group: Group, lost: Lost) -> list[dict[str, Any]]:
    """Entries of a group whose worker died: of what it had finished by then, and of the failure of the rest.

    If the worker was told to end, the rest did not fail: it has no entries.
    """
    entries = []
    for config, transport in group.items:
        entry = None
        # Raised for an item of another config, which was there before: it is not this group's, and is overwritten.
        with suppress(InputError):
            entry = entry_there(run, {"items": []}, config, transport)
        if entry is None and lost.ended:
            continue
        if entry is None or entry["status"] != "done":
            entry = write_failure(run, config, transport, lost.why)
        entries.append(entry)
    return entries
