"""Failed episodes that were filmed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import sqlalchemy as sa
from fastapi import APIRouter, HTTPException, Query
from starlette.responses import Response

from orchestrator.dashboard import queries
from orchestrator.dashboard.desk import Desk, TheDesk
from results.database import StoreError
from results.entries import RunEntry, rows_url
from results.media import MEDIA, look_path, picture_path, videos_folder
from results.record import Status
from results.run import RunError
from results.schema import episodes
from results.store import Store
from suites.vocabulary import Condition

PAGE = 24
"""Films on a page."""
RUNS = 100
"""Newest runs that are looked through."""
router = APIRouter()


@dataclass(frozen=True)
class Film:
    """A failed episode with its video."""

    run_id: str
    run: str
    episode_id: str
    policy: str
    task: str
    condition: str
    seed: int
    steps: int
    video: str
    """Address."""
    poster: str | None
    """Address of a still."""


@router.get("/failures")
def failures(
    desk: TheDesk,
    run: str = "",
    policy: str = "",
    task: str = "",
    page: Annotated[int, Query(ge=1, le=10_000)] = 1,
) -> Response:
    """Films of failures, the newest runs first."""
    entries = _runs(desk, run, policy)
    films = (
        film
        for entry in entries
        for film in films_of(desk, entry)
        if (not policy or film.policy == policy) and (not task or film.task == task)
    )
    shown = list(islice(films, PAGE * (page - 1), PAGE * page + 1))
    return desk.page(
        "failures.html.jinja",
        here="/failures",
        films=shown[:PAGE],
        more=len(shown) > PAGE,
        page=page,
        searched=RUNS,
        wanted={"run": run, "policy": policy, "task": task},
        names=desk.choices(),
        tasks=queries.tasks(desk.history, policy or None),
    )


def films_of(desk: Desk, entry: RunEntry) -> tuple[Film, ...]:
    """Filmed failures of a run; none where its folder or its rows are not at hand."""
    if entry.folder is None:
        return ()
    try:
        changed = videos_folder(Path(entry.folder)).stat().st_mtime_ns
    except OSError:
        return ()
    key = (entry.run_id, changed, entry.counts.done)
    try:
        return desk.films.get(key, lambda: tuple(_films(desk, entry, Path(entry.folder or ""))))
    except (RunError, StoreError, OSError):
        return ()


def _runs(desk: Desk, run: str, policy: str) -> list[RunEntry]:
    if not run:
        return queries.page_of_runs(desk.history, queries.Filter(policy=policy or None), RUNS, 0)
    entry = queries.run_of(desk.history, run) or desk.history.find(run)
    if entry is None:
        raise HTTPException(404, f"The history has no run '{run[:80]}'.")
    return [entry]


def _films(desk: Desk, entry: RunEntry, folder: Path) -> Iterator[Film]:
    """Raises RunError, StoreError, OSError: its rows cannot be read."""
    filmed = sorted(path.stem for path in videos_folder(folder).glob("*.mp4"))
    rows = _failed(rows_url(entry, desk.history.url), entry.run_id, filmed) if filmed else []
    for row in rows:
        condition = Condition(row.axis, row.severity)
        yield Film(
            run_id=entry.run_id,
            run=entry.name,
            episode_id=row.episode_id,
            policy=row.policy,
            task=row.task,
            condition=str(condition),
            seed=row.seed,
            steps=row.steps,
            video=_address(entry, f"{MEDIA}/videos/{row.episode_id}.mp4"),
            poster=_poster(entry, folder, row.task, condition),
        )


def _failed(url: str, run_id: str, ids: list[str]) -> Sequence[Any]:
    e = episodes.c
    columns = (e.episode_id, e.policy, e.task, e.axis, e.severity, e.seed, e.steps)
    query = sa.select(*columns).where(e.run_id == run_id, e.episode_id.in_(ids), e.status == str(Status.FAILURE))
    store = Store.open(url, run_id)
    try:
        with store.database.reading() as connection:
            return connection.execute(query.order_by(e.task, e.policy, e.axis, e.severity, e.seed)).all()
    finally:
        store.close()


def _poster(entry: RunEntry, folder: Path, task: str, condition: Condition) -> str | None:
    for path in (look_path(folder, task, condition), picture_path(folder, task)):
        if path.is_file():
            return _address(entry, path.relative_to(folder).as_posix())
    return None


def _address(entry: RunEntry, path: str) -> str:
    return f"/runs/{quote(entry.run_id, safe='')}/files/{quote(path)}"
