"""`gauntlet replay`: play a stored episode again, compare, film."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, StoreUrl, fail, newest_run, out
from orchestrator.cluster import RayLost
from orchestrator.replay import ReplayError, homes_of, policy_sources, replay_at_home
from results.media import video_path
from results.record import Status
from results.run import RunError, read_run
from results.store import Store, StoreError


def replay_episode(
    episode_id: Annotated[str, typer.Argument(help="Id of a stored episode, or its first digits.")],
    folder: Annotated[Path | None, typer.Option("--run", help="Run folder; by default the newest under runs/.")] = None,
    video: Annotated[Path | None, typer.Option(help="The mp4 to write; by default in the run folder.")] = None,
    store: StoreUrl = None,
) -> None:
    """Play one stored episode again, check that it comes out the same, and write a video of it."""
    folder = folder or newest_run()
    try:
        document = read_run(folder)
        rows = Store.open_begun(folder, document, store)
        row = rows.find(episode_id)
        rows.close()
        if row is None:
            raise BadInput(f"{folder}: no episode {episode_id}; ids are in its episodes.parquet")
        sources = policy_sources(document)
    except (RunError, StoreError, ReplayError) as error:
        raise BadInput(str(error)) from None
    try:
        done = replay_at_home(row, sources, video or video_path(folder, row.episode_id), homes_of(document))
    except (ReplayError, RayLost) as error:
        raise BadInput(str(error)) from None
    if done.result.status == Status.ERROR:
        out.print(f"{row.task}, {row.policy}, seed {row.seed}: {done.result.error}", markup=False, soft_wrap=True)
    else:
        out.print(f"{row.task}, {row.policy}, seed {row.seed}: {done.result.status} after {done.result.steps} steps")
    if done.video.exists():
        out.print(f"video: {done.video}", markup=False, soft_wrap=True)
    if done.differences:
        fail("the episode came out differently:\n" + "\n".join(done.differences))
        raise typer.Exit(1)
    out.print("the same as stored")
