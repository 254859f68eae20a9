"""Writes a run to Weights & Biases, or, with WANDB_MODE=offline, into files that `wandb sync` uploads later."""

from __future__ import annotations

import os
from types import ModuleType

from orchestrator.loggers.entry import COLUMNS, LoggingError, check_project, entry_of
from results.run import RunDocument
from results.tables import Tables


def log_run(document: RunDocument, tables: Tables, *, name: str, project: str) -> str:
    """Write a run's numbers, provenance and tags. A run that was logged before is continued under its id.

    The login, the server and offline mode are W&B's own settings (`wandb login`, WANDB_API_KEY, WANDB_MODE, WANDB_DIR).
    What W&B notes by itself of the program, the machine and the repository is switched off.

    Args:
        document: Of the run.
        tables: Of the run.
        name: Of the run, for people.
        project: Of W&B.

    Returns:
        Where it is: a web address, or the command that uploads the folder of an offline run.

    Raises:
        LoggingError: The library is missing, or does not take the run.
    """
    check_project(project)
    entry = entry_of(document, tables)
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
            config={**entry.provenance, **entry.state},
            tags=list(entry.tags),
            settings=settings,
        )
        run.log({**entry.metrics, "cells": wandb.Table(columns=list(COLUMNS), data=[list(row) for row in entry.rows])})
        where = f"upload it with: wandb sync {run.settings.sync_dir}" if run.offline else str(run.url)
        run.finish()
    except Exception as error:  # its text may hold the key
        trouble = f"W&B did not take the run ({type(error).__name__}); log in with `wandb login`, check --project, "
    else:
        return where
    raise LoggingError(f"{trouble}or write files with WANDB_MODE=offline")


def _library() -> ModuleType:
    os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # its reports of its own crashes, to its makers
    try:
        import wandb
    except ImportError:
        raise LoggingError('W&B is not installed; install it with: pip install "robogauntlet[wandb]"') from None
    return wandb
