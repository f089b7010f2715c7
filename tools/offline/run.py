"""Does a study's trials on all cores, and keeps each as it ends: the next run goes on there."""

from collections.abc import Iterator, Sequence
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import cv2
import msgspec
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

from companion.kernel.errors import CompanionError
from companion.vision.stereo import StereoSettings
from tools.offline.splits import Fold, folds_of
from tools.offline.store import Stored, code_key, write_whole
from tools.offline.study import Study
from tools.offline.trial import Row, Trial, run_trial, trials_of
from tools.progress import progress_bar

Rows = msgspec.json.Decoder(list[Row])


def run_study(
    study: Study,
    paths: Sequence[Path],
    cache: Path,
    workers: int,
    console: Console,
) -> tuple[list[Row], list[Stored]]:
    """All rows in the order of the study, and what they were measured on.

    Raises CompanionError: nothing could be measured, or (after all others) a trial failed.
    """
    recordings = [Stored(path, cache) for path in paths]
    sources = {variant.lab.dictionary for variant in study.variants} - {"flight", "pooled"}
    dictionaries = {source: Stored(study.path.parent / source, cache) for source in sources}
    with _pool(workers) as pool, progress_bar(console) as bar:
        stereos = {variant.plan.stereo for variant in study.variants}
        everything = [*recordings, *dictionaries.values()]
        _prepare(pool, everything, stereos, bar)
        trials = trials_of(study, _folds(study, recordings), tuple(recordings), dictionaries)
        done = _run(pool, trials, cache / "runs" / code_key(), bar)
    return [row for trial in trials for row in done[trial.id]], recordings


def _folds(study: Study, recordings: Sequence[Stored]) -> list[Fold]:
    names = [recording.name for recording in recordings]
    lengths = [len(recording) for recording in recordings]
    seed = study.settings.seeds[0]
    splits = study.settings.split
    return [fold for split in splits for fold in folds_of(split, names, lengths, seed)]


def _prepare(
    pool: Executor,
    recordings: Sequence[Stored],
    stereos: set[StereoSettings],
    bar: Progress,
) -> None:
    """Images first, then λ: two processes must not write the same file."""
    jobs = [pool.submit(_prepare_one, recording, tuple(stereos)) for recording in recordings]
    for job in bar.track(as_completed(jobs), len(jobs), description="recordings"):
        job.result()


def _prepare_one(recording: Stored, stereos: tuple[StereoSettings, ...]) -> None:
    for stereo in stereos:
        recording.prepare(stereo)


def _run(
    pool: Executor, trials: Sequence[Trial], folder: Path, bar: Progress
) -> dict[str, list[Row]]:
    """Rows by the trial's id; those of earlier runs are read."""
    done: dict[str, list[Row]] = {}
    waiting: dict[Future[list[Row]], Trial] = {}
    failures: list[str] = []
    for trial in trials:
        path = folder / f"{trial.id}.json"
        if path.is_file():
            done[trial.id] = Rows.decode(path.read_bytes())
        else:
            waiting[pool.submit(run_trial, trial)] = trial
    task = bar.add_task("trials", total=len(trials), completed=len(trials) - len(waiting))
    for future in as_completed(waiting):
        trial = waiting[future]
        bar.update(task, advance=1, description=trial.label)
        try:
            done[trial.id] = future.result()
        except CompanionError as error:
            failures.append(f"{trial.label}: {error}")
            continue
        write_whole(folder / f"{trial.id}.json", msgspec.json.encode(done[trial.id]))
    if failures:
        raise CompanionError(f"{len(failures)} of {len(trials)} trials failed; {failures[0]}")
    return done


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    """Processes that start afresh, or a thread of this one where one is enough.

    What has not begun is dropped when the work is broken off.
    """
    pool: Executor
    if workers == 1:
        pool = ThreadPoolExecutor(1, initializer=_one_thread)
    else:
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _one_thread)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _one_thread() -> None:
    """A process per core: threads of the libraries would only wait for each other."""
    cv2.setNumThreads(1)
    threadpool_limits(1)
