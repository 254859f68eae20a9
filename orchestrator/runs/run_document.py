"""Creates the document of a new run, or updates that of a continued run."""

from __future__ import annotations

import os
import platform
import subprocess
import time
import uuid
from importlib import metadata
from pathlib import Path

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.environments.environment import EnvironmentUser, environment_users
from robogauntlet.orchestrator.runs.plan import Plan, check_same
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.results.analysis.comparison import OWN
from robogauntlet.results.run_document import (
    EVERYWHERE,
    LATEST,
    RUN_FILE,
    Provenance,
    RunDocument,
    RunStatus,
    read_run,
    shortened,
)
from robogauntlet.results.store.database import without_password

PROCESSORS = Path("/proc/cpuinfo")


def create_or_continue(plan: Plan, folder: Path, store: str | None) -> RunDocument:
    """Return the document of a new run, or of the run in `folder`, which is continued; for `store` see `RunOptions`.

    Raises:
        PlanError: The folder holds another run, or the machine's clock is before 1970 or after 2200.
        StoreError: `store` is not the URL of a store.
    """
    available = [name for name in plan.simulators if name not in plan.unavailable]
    workers = {} if plan.suite.workers == "auto" else {name: plan.suite.worker_count(name) for name in available}
    if (folder / RUN_FILE).exists():
        document = read_run(folder)
        check_same(plan, document, folder)
        changes = {
            "status": RunStatus.RUNNING,
            "reason": None,
            "suite": plan.suite,
            "suite_text": plan.text,
            "suite_path": str(plan.path),
            "tasks_left_out": plan.left_out,
            "warnings": plan.warnings,
            "server_metadata": _server_metadata(plan, document, folder),
            "workers": workers,
            "shared_workers": None,
            "provenance": _continued_provenance(plan, document, folder),
        }
        return document.model_copy(update=changes)
    if not 0 <= (now := time.time()) <= LATEST:
        raise PlanError("this machine's clock is before 1970 or after 2200; set it")
    cards = simulators.task_descriptions()
    return RunDocument(
        run_id=uuid.uuid4().hex,
        suite=plan.suite,
        suite_hash=plan.suite_hash,
        suite_text=plan.text,
        suite_path=str(plan.path),
        store_url=None if store is None else without_password(store),
        started_at=now,
        plan=plan.planned_cells(),
        unsupported=plan.unsupported,
        tasks_left_out=plan.left_out,
        warnings=plan.warnings,
        server_metadata=dict(plan.server_metadata),
        instructions={task: cards[task].instruction for task in plan.suite.tasks},
        robots={task: robot for task in plan.suite.tasks if (robot := cards[task].robot)},
        workers=workers,
        skipped={name: shortened(reason) for name, reason in plan.unavailable.items()},
        provenance=_new_provenance(plan),
    )


def _server_metadata(plan: Plan, document: RunDocument, folder: Path) -> dict[str, str]:
    """What the servers of policies say of themselves. PlanError if it has changed under a policy's identity."""
    known = document.server_metadata
    for name, now in plan.server_metadata.items():
        if known.get(name, now) != now:
            raise PlanError(
                f"{folder}: the server of policy '{name}' sends other metadata than when the run began, under the same "
                "identity; give another checkpoint another identity, and another folder with --out"
            )
    return {**known, **plan.server_metadata}


def _environment_users(plan: Plan) -> list[EnvironmentUser]:
    """The plan's simulators, and its kinds of policies with requirements."""
    kinds = {source.kind for source in plan.sources.values()}
    return [user for name, user in environment_users().items() if name in plan.simulators or name in kinds]


def _new_provenance(plan: Plan) -> Provenance:
    """The software and hardware here; versions are those in each simulator's or policy's environment."""
    users, environments = _environment_users(plan), plan.environments
    records = {user.name: environments.record(user) for user in users}
    distributions = [name for user in users if environments.resolve(user) is None for name in user.distributions]
    status = _git("status", "--porcelain", "--untracked-files=no")
    packages = {name: version for name in dict.fromkeys([*EVERYWHERE, *distributions]) if (version := _version(name))}
    return Provenance(
        git_commit=_git("rev-parse", "HEAD"),
        git_dirty=bool(status) if status is not None else None,
        python=platform.python_version(),
        platform=platform.platform(),
        processor=_processor(),
        cores=os.cpu_count() or 0,
        packages=packages,
        environments={name: record for name, record in records.items() if record is not None},
    )


def _continued_provenance(plan: Plan, document: RunDocument, folder: Path) -> Provenance:
    """The provenance of a continued run, with the environments of simulators that were unavailable before.

    Raises:
        PlanError: A simulator has changed, so that the run would mix two versions.
    """
    before = document.provenance
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


def _git(*arguments: str) -> str | None:
    """Output of git in this code's folder, or None outside a repository."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parent, capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    """Name, family and model: virtual machines often have one name for several, and these round differently."""
    try:
        lines = PROCESSORS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    fields = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in reversed(lines))}
    name = fields.get("model name", platform.machine())
    return f"{name} (family {fields['cpu family']}, model {fields['model']})" if "cpu family" in fields else name
