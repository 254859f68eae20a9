"""The document of a run as it begins, or begins again."""

from __future__ import annotations

import time
import uuid
from pathlib import Path

from adapters import catalog as simulators
from orchestrator import provenance
from orchestrator.environments.environment import Tenant, tenants
from orchestrator.plan import Plan, PlanError, check_same
from results.comparison import OWN
from results.database import without_password
from results.run import RUN_FILE, Provenance, RunDocument, RunStatus, read_run


def begin(plan: Plan, folder: Path, store: str | None) -> RunDocument:
    """The document of a new run, or of the one in `folder` that is to be continued.

    Args:
        plan: What is to be played.
        folder: Of the run.
        store: URL of the store, or None for a file in the folder.

    Raises:
        PlanError: The folder holds another run, or its rows are elsewhere.
        StoreError: That is no URL of a store.
    """
    workers = fixed_workers(plan)
    if (folder / RUN_FILE).exists():
        document = read_run(folder)
        check_same(plan, document, folder)
        made = _continued(plan, document, folder)
        if document.store_url is not None and store is None:
            raise PlanError(f"{folder}: its rows are in {document.store_url}; give that address with --store")
        return document.model_copy(
            update={
                "status": RunStatus.RUNNING,
                "reason": None,
                "workers": workers,
                "provenance": made,
                "merging": plan.suite.merging,
                "gate": plan.suite.gate,
                "floors": plan.suite.floors,
                "compare": plan.suite.comparison,
                "regression": plan.suite.regression,
            }
        )
    cards = simulators.task_cards()
    return RunDocument(
        run_id=uuid.uuid4().hex,
        suite_name=plan.suite.name,
        suite_description=plan.suite.description,
        suite_hash=plan.suite_hash,
        suite_text=plan.text,
        suite_path=str(plan.path),
        store_url=None if store is None else without_password(store),
        started_at=time.time(),
        plan=plan.planned_cells(),
        unsupported=plan.unsupported,
        instructions={task: cards[task].instruction for task in plan.suite.tasks},
        merging=plan.suite.merging,
        compare=plan.suite.comparison,
        adaptive=plan.suite.adaptive,
        regression=plan.suite.regression,
        gate=plan.suite.gate,
        floors=plan.suite.floors,
        workers=workers,
        skipped=dict(plan.unavailable),
        provenance=provenance.collect(_tenants(plan), plan.homes, _definitions(plan)),
    )


def _definitions(plan: Plan) -> dict[str, str]:
    """Task to the hash of the file that defines it now, for those of the plan's that have one."""
    known = {
        f"{one.name}/{task}": found
        for one in simulators.simulators().values()
        for task, found in one.definitions.items()
    }
    return {task: known[task] for task in plan.suite.tasks if task in known}


def _tenants(plan: Plan) -> list[Tenant]:
    """The plan's simulators, and its kinds of policies that need distributions of their own."""
    kinds = {source.kind for source in plan.sources.values()}
    return [one for name, one in tenants().items() if name in plan.simulators or name in kinds]


def _continued(plan: Plan, document: RunDocument, folder: Path) -> Provenance:
    """The provenance of a run that goes on, with the environments of simulators that could not run before.

    Raises:
        PlanError: A simulator is no longer what it was, and the run would mix two.
    """
    made = document.provenance
    for task, now in _definitions(plan).items():
        if (was := made.definitions.get(task, now)) != now:
            raise PlanError(
                f"{folder}: expected {task} as it was when the run began ({was}), its file has changed ({now}); "
                "give another folder with --out"
            )
    environments = dict(made.environments)
    for tenant in (one for one in _tenants(plan) if one.name not in plan.unavailable):
        name, record = tenant.name, plan.homes.record(tenant)
        if name in document.skipped and record is not None:
            environments[name] = record
        elif name not in document.skipped and record != environments.get(name):
            was, now = (f"environment {one.hash}" if one else OWN for one in (environments.get(name), record))
            raise PlanError(
                f"{folder}: {name} ran in {was}, and would now run in {now if now != was else 'other versions of it'}; "
                "give another folder with --out"
            )
    return made.model_copy(update={"environments": environments})


def fixed_workers(plan: Plan) -> dict[str, int]:
    """Simulator to its number of workers; empty if they are not counted by simulator."""
    if plan.suite.workers == "auto":
        return {}
    return {name: plan.suite.worker_count(name) for name in plan.simulators if name not in plan.unavailable}
