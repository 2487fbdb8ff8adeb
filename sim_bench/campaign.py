"""Every Monte Carlo goes through here: cases in, one tidy table out, repeatable, parallel, resumed when stopped.

A case is a small dict, e.g. {"scenario": "p1", "run": 3}. Its random numbers follow from the campaign's seed and its
own content alone, so a campaign can grow, shrink or change its order without changing what a case finds. What is to be
compared on the same noise (several filters, say) belongs in one case that returns several rows.

A folder holds one campaign: `campaign.json` says which, `cases/` has a file per finished case, `table.parquet` is
written at the end from all of them.
"""

import fcntl
import hashlib
import json
import os
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

import servohil
from servohil._compiled_cache import ROOMS
from servohil.hil.claims import write_atomically
from servohil.sim_bench.campaign_cases import SEED, CampaignError, Case, case_seed, plain_cases, plain_row
from servohil.sim_bench.campaign_table import TABLE, Row, write_table

Run = Callable[[Row, np.random.Generator], Mapping[str, Any] | Sequence[Mapping[str, Any]]]

NAMED_FAILURES: Final = 10


@dataclass(frozen=True)
class Failure:
    """A case that raised.

    Attributes:
        case: its content.
        seed: of its generator, see `case_seed`.
        error: type and text of the exception.
        traceback: of the exception, as Python prints it.
    """

    case: Row
    seed: int
    error: str
    traceback: str


class FailedCasesError(CampaignError):
    """Cases raised; all others are finished, and in the table if there are any.

    Attributes:
        failures: in the order of the table.
    """

    def __init__(self, failures: Sequence[Failure], total: int, folder: Path) -> None:
        """The message names the first cases; all tracebacks are in `failures` and in the files of `cases/`."""
        self.failures = tuple(failures)
        lines = [f"{folder}: {len(failures)} of {total} cases failed (the next call runs them again):"]
        lines += [f"  {failure.case}: {failure.error}" for failure in failures[:NAMED_FAILURES]]
        if len(failures) > NAMED_FAILURES:
            lines.append(f"  and {len(failures) - NAMED_FAILURES} more")
        super().__init__("\n".join(lines))


def run_campaign(
    run: Run, cases: Iterable[Case], folder: Path, *, seed: int, version: str,
    workers: int | None = None, progress: bool = True,
) -> Path:  # fmt: skip
    """Run the cases that are not finished yet and write the table of all; returns the table's path.

    The table has a row per case and result row, sorted by case; columns: the cases' keys, the figures, `seed`. It is
    the same, bit for bit, whatever the order of the cases, the workers, and how often the campaign was interrupted.

    Args:
        run: a module's function. Takes a case and its generator, returns figures (text, truth value, number or None)
            as a dict or a list of dicts. Runs in several threads at once: build filters inside, and spend the time in
            compiled code that releases the interpreter's lock.
        cases: dicts of text, truth value, int or float. 1 and 1.0 are the same, as in Python.
        folder: made where missing; finished cases in it are not run again, also those of another list.
        seed: of the campaign.
        version: of what `run` computes. Change it with the code: the folder of another version is refused.
        workers: threads; None: one per processor. 1 runs in the caller's thread.
        progress: show a progress bar.

    Raises:
        CampaignError: a case or the folder cannot be used, or figures of different types share a column.
        FailedCasesError: after all else has run.
    """
    if workers is not None and workers < 1:
        raise CampaignError(f"workers = {workers}: must be at least 1, or None for one per processor")
    name = getattr(run, "__qualname__", "<unnamed>")
    if name.endswith(("<lambda>", "<unnamed>")):
        raise CampaignError(f"run = {run!r}: must be a named function, by which the folder is known again")
    identity = {"run": f"{run.__module__}.{name}", "version": version, "seed": seed}
    by_digest = plain_cases(cases, seed)
    with _claimed(folder, identity):
        (folder / TABLE).unlink(missing_ok=True)  # a table is never older than the cases beside it
        missing = [(case, path) for case, path in _files(folder, by_digest) if "rows" not in _read(path)]
        _run_all([partial(_finish, run, case, seed, path) for case, path in missing], workers, progress)
        rows: list[Row] = []
        failures = []
        for case, path in _files(folder, by_digest):
            own_seed, found = case_seed(case, seed), _read(path)
            rows += [{**case, **figures, SEED: own_seed} for figures in found.get("rows", [])]
            if "error" in found:
                failures.append(Failure(case, own_seed, found["error"], found["traceback"]))
        if rows:
            keys = sorted({key for case in by_digest.values() for key in case})
            try:
                write_table(folder / TABLE, rows, keys, SEED, {**identity, "failed": len(failures)})
            except ValueError as error:
                raise CampaignError(f"{folder}: {error}") from None
    if failures:
        raise FailedCasesError(failures, len(by_digest), folder)
    return folder / TABLE


def source_version() -> str:
    """A `version` that changes with every edit: a hash of the project's own sources. 16 hex digits."""
    package = Path(servohil.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for room in ROOMS for path in (package / room).rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _run_all(jobs: Sequence[Callable[[], None]], workers: int | None, progress: bool) -> None:
    from rich.progress import MofNCompleteColumn, Progress

    with Progress(*Progress.get_default_columns(), MofNCompleteColumn(), transient=True, disable=not progress) as bar:
        task = bar.add_task("cases", total=len(jobs))
        if workers == 1:
            for job in jobs:
                job()
                bar.advance(task)
            return
        with ThreadPoolExecutor(workers or len(os.sched_getaffinity(0))) as pool:
            try:
                for future in as_completed([pool.submit(job) for job in jobs]):
                    future.result()  # raises what is no case's fault, e.g. a full disk
                    bar.advance(task)
            except BaseException:
                pool.shutdown(cancel_futures=True)  # at Ctrl-C only the cases at work are waited for
                raise


def _finish(run: Run, case: Row, seed: int, path: Path) -> None:
    found: dict[str, Any] = {"case": case}
    try:
        result = run(dict(case), np.random.default_rng(case_seed(case, seed)))
        found["rows"] = _figures([result] if isinstance(result, Mapping) else result, case)
    except Exception as error:
        found["error"] = "".join(traceback.format_exception_only(error)).strip()
        found["traceback"] = traceback.format_exc()
    write_atomically(path, json.dumps(found))


def _figures(rows: Sequence[Mapping[str, Any]], case: Row) -> list[Row]:
    if not isinstance(rows, Sequence) or not rows or not all(isinstance(row, Mapping) for row in rows):
        raise CampaignError(f"run returned {rows!r}: expected a dict of figures, or a list of at least one")
    taken = sorted({str(name) for row in rows for name in row if name in case or name == SEED})
    if taken:
        raise CampaignError(f"figures {taken}: the names of the case's keys and {SEED!r} are taken")
    return [plain_row(row, "figure") for row in rows]


def _files(folder: Path, by_digest: Mapping[str, Row]) -> Iterator[tuple[Row, Path]]:
    return ((case, folder / "cases" / f"{digest}.json") for digest, case in by_digest.items())


def _read(path: Path) -> dict[str, Any]:
    """What is known of a case: nothing where its file is missing, or damaged (by a disk; a kill cannot)."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


@contextmanager
def _claimed(folder: Path, identity: Mapping[str, Any]) -> Iterator[None]:
    """Hold the folder against other processes, and refuse it if it is another campaign's."""
    try:
        (folder / "cases").mkdir(parents=True, exist_ok=True)
        lock = (folder / "campaign.lock").open("w")
    except OSError as error:
        raise CampaignError(f"folder {folder} cannot be written: {error}") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the kernel drops it when the process dies
        except BlockingIOError:
            raise CampaignError(f"folder {folder}: a campaign is running in it") from None
        for leftover in (*folder.glob(".campaign.json.*"), *folder.glob("cases/.*"), *folder.glob(f".{TABLE}")):
            leftover.unlink()  # of a killed run
        named = folder / "campaign.json"
        if not named.exists() and not any((folder / "cases").iterdir()):
            write_atomically(named, json.dumps(identity) + "\n")
        try:
            found = json.loads(named.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise CampaignError(f"folder {folder} holds cases of an unknown campaign: {error}") from None
        if found != identity:
            raise CampaignError(
                f"folder {folder} holds another campaign, {found}; this one is {identity}: remove the folder"
            )
        yield
