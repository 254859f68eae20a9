"""The page with videos of failed episodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import sqlalchemy as sa
from fastapi import APIRouter, Query
from starlette.responses import Response

from robogauntlet.orchestrator.dashboard import queries
from robogauntlet.orchestrator.dashboard.app_state import AppState, CurrentAppState
from robogauntlet.results.media_paths import MEDIA, SHARED_BY, picture_path, snapshot_path, videos_folder
from robogauntlet.results.record import FailureKind, Status, outcome_text
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import RunEntry, rows_url
from robogauntlet.results.store.schema import episodes
from robogauntlet.suites.episode import Condition

PAGE = 24
"""Videos per page."""
RUNS = 100
"""Number of runs, the newest, whose videos are listed."""
router = APIRouter()


@router.get("/failures")
def failures(
    app_state: CurrentAppState,
    run: str = "",
    policy: str = "",
    task: str = "",
    kind: str = "",
    page: Annotated[int, Query(ge=1, le=10_000)] = 1,
) -> Response:
    """List videos of failures, the newest runs first."""
    shown = _shown(app_state, run, policy, task, kind, page)
    return app_state.page(
        "failures.html.jinja",
        here="/failures",
        videos=shown[:PAGE],
        more=len(shown) > PAGE,
        page=page,
        searched=RUNS,
        wanted={"run": run, "policy": policy, "task": task, "kind": kind},
        kinds=list(FailureKind),
        names=app_state.choices(),
        tasks=queries.tasks(app_state.history, policy or None),
    )


def _shown(app_state: AppState, run: str, policy: str, task: str, kind: str, page: int) -> list[dict[str, Any]]:
    """The videos of a page, and one more if there is a next page."""
    wanted = queries.Filter(policy=policy or None)
    entries = [app_state.run_named(run)] if run else queries.page_of_runs(app_state.history, wanted, RUNS, 0)
    videos = (
        video
        for entry in entries
        for video in failure_videos(app_state, entry)
        if policy in ("", video["policy"]) and task in ("", video["task"]) and kind in ("", video["failure"])
    )
    return list(islice(videos, PAGE * (page - 1), PAGE * page + 1))


def failure_videos(app_state: AppState, entry: RunEntry) -> tuple[dict[str, Any], ...]:
    """Return the videos of a run's failures; none if its folder or rows cannot be read."""
    if entry.folder is None:
        return ()
    folder = Path(entry.folder)
    try:
        key = ("videos", entry.run_id, videos_folder(folder).stat().st_mtime_ns, entry.counts.done)
        return app_state.answers.get(key, lambda: tuple(_read_videos(app_state, entry, folder)))
    except (RunError, StoreError, OSError):
        return ()


def _read_videos(app_state: AppState, entry: RunEntry, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the videos of a run's failures. Raises RunError, StoreError, OSError."""
    recorded = [path.stem for path in videos_folder(folder).glob("*.mp4")]
    for row, video in _failed(rows_url(entry, app_state.history.url), entry.run_id, recorded):
        condition = Condition(row.axis, row.severity)
        yield {
            **row._mapping,
            "run_id": entry.run_id,
            "run": entry.name,
            "condition": str(condition),
            "outcome": outcome_text(Status.FAILURE, row.failure),
            "video": _address(entry, f"{MEDIA}/videos/{video}.mp4"),
            "poster": _poster(entry, folder, row.task, condition),
        }


def _failed(url: str, run_id: str, ids: Sequence[str]) -> list[tuple[Any, str]]:
    """Failures that the videos of these episodes show, each with the episode of its video."""
    e = episodes.c
    shared = [e[name] for name in SHARED_BY]
    videos = sa.select(*shared, e.episode_id).where(e.run_id == run_id, e.episode_id.in_(ids))
    columns = (e.episode_id, e.policy, e.task, e.axis, e.severity, e.seed, e.steps, e.failure)
    query = sa.select(*columns, *shared).where(e.run_id == run_id, e.status == str(Status.FAILURE))
    query = query.order_by(e.task, e.policy, e.axis, e.severity, e.seed)
    with closing(Store.open(url, run_id, create=False)) as store, store.database.reading() as connection:
        video_of = {tuple(shared): name for *shared, name in connection.execute(videos)}
        same_pair = connection.execute(query.where(e.pair_id.in_({pair for pair, *_ in video_of})))
        return [(row, video_of[key]) for row in same_pair if (key := tuple(row[len(columns) :])) in video_of]


def _poster(entry: RunEntry, folder: Path, task: str, condition: Condition) -> str | None:
    for path in (snapshot_path(folder, task, condition), picture_path(folder, task)):
        if path.is_file():
            return _address(entry, path.relative_to(folder).as_posix())
    return None


def _address(entry: RunEntry, path: str) -> str:
    return f"/runs/{quote(entry.run_id, safe='')}/files/{quote(path)}"
