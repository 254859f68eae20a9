"""Sends a run to Weights & Biases, or, with WANDB_MODE=offline, writes files for `wandb sync`."""

from __future__ import annotations

import os
from types import ModuleType

from robogauntlet.orchestrator.trackers.tracked_run import COLUMNS, TrackerError, check_project, tracked_run
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.run_document import RunDocument


def log_run(document: RunDocument, tables: Tables, *, name: str, project: str) -> str:
    """Send numbers, provenance and tags of a run to W&B.

    Login, server and offline mode are W&B's own settings (`wandb login`, WANDB_API_KEY, WANDB_MODE, WANDB_DIR). W&B's
    own records of program, machine and repository are disabled.

    Returns:
        A web address, or the command that uploads an offline run.
    """
    check_project(project)
    summary = tracked_run(document, tables)
    wandb = _library()
    try:
        settings = wandb.Settings(
            silent=True,
            console="off",
            disable_git=True,
            disable_code=True,
            x_disable_machine_info=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_save_requirements=False,
            init_timeout=30,
        )
        run = wandb.init(
            project=project,
            name=name,
            id=document.run_id,
            resume="allow",
            config={**summary.provenance, **summary.state},
            tags=list(summary.tags),
            settings=settings,
        )
        cells = wandb.Table(columns=list(COLUMNS), data=[list(row) for row in summary.rows])
        run.log({**summary.metrics, "cells": cells})
        address = f"upload it with: wandb sync {run.settings.sync_dir}" if run.offline else str(run.url)
        run.finish()
    except Exception as error:  # its text may contain the API key
        problem = f"W&B did not accept the run ({type(error).__name__}); log in with `wandb login`, check --project, "
    else:
        return address
    raise TrackerError(f"{problem}or write files with WANDB_MODE=offline")


def _library() -> ModuleType:
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # no crash reports to W&B
    try:
        import wandb
    except ImportError:
        raise TrackerError('W&B is not installed; install it with: pip install "robogauntlet[wandb]"') from None
    return wandb
