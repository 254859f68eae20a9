"""`robogauntlet replay`: replay a stored episode and record a video of it, or verify a run."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import OwnSuite, StoreUrl, fail, newest_run, out, print_line, refuse
from robogauntlet.orchestrator.cli.verification import verify_run
from robogauntlet.orchestrator.ray_runtime.session import RayLost
from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter
from robogauntlet.orchestrator.replay.replay import environments_of, policy_sources, replay_with_video
from robogauntlet.orchestrator.runs.playable_suite import playable_suite
from robogauntlet.results.media_paths import video_path
from robogauntlet.results.record import EpisodeResult, Status, outcome_text
from robogauntlet.results.run_document import RunDocument, read_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import CLEAN
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted, visible


def replay(
    episode_id: Annotated[
        str | None,
        typer.Argument(
            metavar="EPISODE",
            help="Id of a stored episode, or the beginning of it (robogauntlet list episodes); or --policy, --task "
            "and --seed. With --verify: the run folder.",
            show_default=False,
        ),
    ] = None,
    folder: Annotated[Path | None, typer.Option("--run", help="Run folder; by default the newest under runs/.")] = None,
    policy: Annotated[str | None, typer.Option(help="The episode of this policy.")] = None,
    task: Annotated[str | None, typer.Option(help="The episode in this task (simulator/task).")] = None,
    seed: Annotated[
        int | None, typer.Option(help="The episode with this seed; with --verify, the seed of the random choice (0).")
    ] = None,
    at: Annotated[
        str | None,
        typer.Option("--condition", metavar="AXIS@SEVERITY", help="The episode under it; by default the clean one."),
    ] = None,
    video: Annotated[Path | None, typer.Option(help="MP4 file to write; by default in the run folder.")] = None,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify", help="Check the rows of the run against their hash, and replay a sample of its episodes."
        ),
    ] = False,
    sample: Annotated[
        int | None, typer.Option(min=0, help="With --verify: number of random episodes to replay (12).")
    ] = None,
    store: StoreUrl = None,
    suite: OwnSuite = None,
) -> None:
    """Replay a stored episode and record a video, or verify a run.

    The episode is compared with its row. Exit code 1 if something differs from the rows.
    """
    if verify:
        given = {"--run": folder and episode_id, "--policy": policy, "--task": task, "--condition": at}
        refuse("--verify", given | {"--video": video})
        run = folder or (newest_run() if episode_id is None else Path(episode_id))
        verify_run(run, 12 if sample is None else sample, seed or 0, store, suite)
        return
    if sample is not None:
        raise BadInput("--sample: expected with --verify")
    named = {"--policy": policy, "--task": task, "--seed": seed, "--condition": at}
    if episode_id is not None and (beside := next((name for name, value in named.items() if value is not None), None)):
        raise BadInput(f"expected an episode's id or {beside}, got both")
    folder = folder or newest_run()
    document = read_run(folder)
    with closing(Store.open_begun(folder, document, store)) as rows:
        by_name = None if episode_id else _named(folder, document, rows, policy, task, seed, at or CLEAN)
        row = rows.find(episode_id) if episode_id else by_name
    if row is None:
        raise BadInput(f"{folder}: no episode {episode_id}; ids are listed by: robogauntlet list episodes {folder}")
    if row.episode_id != row.episode.id:
        raise BadInput(f"{folder}: the row of episode {visible(row.episode_id)} is that of another; it is not replayed")
    video = video or video_path(folder, row.episode_id)
    try:
        played_by = playable_suite(document, folder, suite)
        replay = replay_with_video(row, policy_sources(document, played_by), video, environments_of(played_by))
    except RayLost as error:
        raise BadInput(str(error)) from None
    result = replay.result
    ended = f"{outcome_text(result.status, result.failure)} after {counted(result.steps, 'step')}"
    outcome = result.error if result.status == Status.ERROR else ended
    print_line(f"{row.task}, {row.policy}, seed {row.seed}: {outcome}")
    if video.exists():
        print_line(f"video: {video}")
    if replay.differences:
        fail("the outcome differs from the stored row:\n" + "\n".join(replay.differences))
        raise typer.Exit(1)
    out.print("the same as stored")


def _named(
    folder: Path, document: RunDocument, rows: Store, policy: str | None, task: str | None, seed: int | None, at: str
) -> EpisodeResult:
    """The only episode of a policy in a task with a seed under a condition. Raises BadInput."""
    if policy is None or task is None or seed is None:
        needed = {"--policy": policy, "--task": task, "--seed": seed}
        missing = ", ".join(name for name, value in needed.items() if value is None)
        raise BadInput(f"expected an episode's id, or --policy, --task and --seed; got no id and no {missing}")
    chosen = EpisodeFilter((policy,), (task,), (at,), seeds=(seed,))
    found = chosen.select(document, rows.results())
    if len(found) != 1:
        listed = f"robogauntlet list episodes {folder}"
        raise BadInput(f"{folder}: expected one such episode, the run has {len(found)}; they are listed by: {listed}")
    return found[0]
