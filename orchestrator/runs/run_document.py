"""Creates the document of a new run, or updates that of a resumed run."""

from __future__ import annotations

import time
import uuid
from pathlib import Path

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.environments.environment import EnvironmentUser, environment_users
from robogauntlet.orchestrator.runs import provenance
from robogauntlet.orchestrator.runs.plan import Plan, PlanError, check_same
from robogauntlet.results.analysis.comparison import OWN
from robogauntlet.results.run_document import RUN_FILE, Provenance, RunDocument, RunStatus, read_run
from robogauntlet.results.store.database import without_password


def create_or_resume(plan: Plan, folder: Path, store: str | None) -> RunDocument:
    """Return the document of a new run, or of the run in `folder`, which is continued.

    Args:
        plan: The plan.
        folder: The run folder.
        store: URL of the store, or None for a file in the folder.

    Raises:
        PlanError: The folder holds another run.
        StoreError: `store` is not the URL of a store.
    """
    workers = fixed_workers(plan)
    if (folder / RUN_FILE).exists():
        document = read_run(folder)
        check_same(plan, document, folder)
        provenance_now = _continued_provenance(plan, document, folder)
        return document.model_copy(
            update={
                "status": RunStatus.RUNNING,
                "reason": None,
                "suite": plan.suite,
                "suite_text": plan.text,
                "suite_path": str(plan.path),
                "workers": workers,
                "shared_workers": None,
                "provenance": provenance_now,
            }
        )
    cards = simulators.task_descriptions()
    return RunDocument(
        run_id=uuid.uuid4().hex,
        suite=plan.suite,
        suite_hash=plan.suite_hash,
        suite_text=plan.text,
        suite_path=str(plan.path),
        store_url=None if store is None else without_password(store),
        started_at=time.time(),
        plan=plan.planned_cells(),
        unsupported=plan.unsupported,
        instructions={task: cards[task].instruction for task in plan.suite.tasks},
        workers=workers,
        skipped=dict(plan.unavailable),
        provenance=provenance.collect(_environment_users(plan), plan.environments, _definitions(plan)),
    )


def _definitions(plan: Plan) -> dict[str, str]:
    """Task of the plan to the current hash of the file that defines it, if it has one."""
    known = {
        f"{simulator.name}/{task}": file_hash
        for simulator in simulators.simulators().values()
        for task, file_hash in simulator.definitions.items()
    }
    return {task: known[task] for task in plan.suite.tasks if task in known}


def _environment_users(plan: Plan) -> list[EnvironmentUser]:
    """The plan's simulators, and its kinds of policies with requirements."""
    kinds = {source.kind for source in plan.sources.values()}
    return [user for name, user in environment_users().items() if name in plan.simulators or name in kinds]


def _continued_provenance(plan: Plan, document: RunDocument, folder: Path) -> Provenance:
    """The provenance of a resumed run, with the environments of simulators that were unavailable before.

    Raises:
        PlanError: A simulator has changed, so that the run would mix two versions.
    """
    before = document.provenance
    for task, now in _definitions(plan).items():
        if (was := before.definitions.get(task, now)) != now:
            raise PlanError(
                f"{folder}: expected {task} as it was when the run began ({was}), its file has changed ({now}); "
                "give another folder with --out"
            )
    environments = dict(before.environments)
    for user in _environment_users(plan):
        name, record = user.name, plan.environments.record(user)
        if name in plan.unavailable:
            continue
        if name in document.skipped and record is not None:
            environments[name] = record
        elif name not in document.skipped and record != environments.get(name):
            was, now = (f"environment {env.hash}" if env else OWN for env in (environments.get(name), record))
            raise PlanError(
                f"{folder}: {name} ran in {was}, and would now run in {now if now != was else 'other versions of it'}; "
                "give another folder with --out"
            )
    return before.model_copy(update={"environments": environments})


def fixed_workers(plan: Plan) -> dict[str, int]:
    """Simulator to its number of workers; empty if the suite's number is `auto`."""
    if plan.suite.workers == "auto":
        return {}
    return {name: plan.suite.worker_count(name) for name in plan.simulators if name not in plan.unavailable}
