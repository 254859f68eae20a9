"""`robogauntlet replay --verify`: check that the rows of a run are unchanged and its episodes can be reproduced."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import typer

from robogauntlet.orchestrator.cli.common import fail, out, print_line
from robogauntlet.orchestrator.replay.replay import environments_of, policy_sources
from robogauntlet.orchestrator.runs.playable_suite import playable_suite
from robogauntlet.results.run_document import read_run, refuse_imported
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import Condition
from robogauntlet.support.text import counted


def verify_run(folder: Path, sample: int, seed: int, store: str | None, suite: str | None) -> None:
    """Check the rows of a run against their hash and replay a sample of its episodes; exit if something differs."""
    from robogauntlet.orchestrator.ray_runtime.session import RayLost, ray_session
    from robogauntlet.orchestrator.replay import verify

    document = read_run(folder)
    refuse_imported(folder, document, "verified")
    played = playable_suite(document, folder, suite) if sample else None
    with closing(Store.open_begun(folder, document, store)) as rows:
        stored = verify.sample_rows(rows.results(), sample, seed)
    sources = policy_sources(document, played) if played and stored.sample else {}
    problems = []
    rows_text = f"{counted(stored.rows, 'row')}, hash {stored.rows_hash}"
    if document.rows_hash is None:
        out.print(f"{rows_text}; run.json has no hash, since the run has not ended")
    elif document.rows_hash == stored.rows_hash:
        out.print(f"{rows_text}, as in run.json")
    else:
        problems.append(f"expected the hash {document.rows_hash} of run.json, the rows have {stored.rows_hash}")

    if played and stored.sample:
        environments = environments_of(played)
        try:
            with ray_session(address=None, workers=len({row.simulator for row in stored.sample})):
                for checked in verify.check_rows(stored.sample, sources, environments):
                    row = checked.row
                    condition = Condition(row.axis, row.severity)
                    name = f"{row.episode_id} {row.task}, {row.policy}, {condition}, seed {row.seed}"
                    verdict = "differs" if checked.differences else "the same"
                    print_line(f"{name}: {verdict}")
                    problems += [f"{name}: {line}" for line in checked.differences]
        except RayLost as error:
            problems.append(f"{error}; verify again")
    if problems:
        fail("\n".join(problems))
        raise typer.Exit(1)
    if stored.sample:
        out.print(f"{len(stored.sample)} of {counted(stored.rows, 'episode')} replayed: all the same")
    else:
        out.print(f"no episode of {stored.rows} replayed")
