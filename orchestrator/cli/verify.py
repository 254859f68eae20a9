"""`gauntlet verify`: does a run still say what it said, and do its episodes come out the same."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, StoreUrl, fail, newest_run, out
from orchestrator.replay import ReplayError, homes_of, policy_sources
from results.run import RunError, read_run
from results.store import Store, StoreError


def verify(
    folder: Annotated[Path | None, typer.Argument(help="Run folder; by default the newest under runs/.")] = None,
    sample: Annotated[int, typer.Option(min=0, help="Episodes to play again, drawn at random.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 0,
    store: StoreUrl = None,
) -> None:
    """Hash the rows of a run anew, play a random sample of its episodes again, and compare; exit code 1: differs."""
    from orchestrator import verifying
    from orchestrator.cluster import RayLost, ray_session

    folder = folder or newest_run()
    try:
        document = read_run(folder)
        rows = Store.open_begun(folder, document, store)
        found = verifying.read(rows.results(), sample, seed)
        rows.close()
        sources = policy_sources(document) if found.sample else {}
        homes = homes_of(document)
    except (RunError, StoreError, ReplayError) as error:
        raise BadInput(str(error)) from None
    problems = []
    said = f"{found.rows:,} rows, hash {found.rows_hash}"
    if document.rows_hash is None:
        out.print(f"{said}; run.json has none yet, since the run did not end")
    elif document.rows_hash == found.rows_hash:
        out.print(f"{said}, as in run.json")
    else:
        problems.append(f"expected the hash {document.rows_hash} of run.json, the rows have {found.rows_hash}")

    def tell(checked: verifying.Checked) -> None:
        row = checked.row
        name = f"{row.episode_id} {row.task}, {row.policy}, {row.axis}@{row.severity}, seed {row.seed}"
        out.print(f"{name}: {'differs' if checked.differences else 'the same'}", markup=False, soft_wrap=True)
        problems.extend(f"{name}: {line}" for line in checked.differences)

    if found.sample:
        try:
            with ray_session(address=None, workers=len({row.simulator for row in found.sample})):
                verifying.play_again(found.sample, sources, tell, homes)
        except RayLost as error:
            problems.append(f"{error}; verify again")
    if problems:
        fail("\n".join(problems))
        raise typer.Exit(1)
    out.print(f"{len(found.sample)} of {found.rows:,} episodes played again: all the same")
