"""`robogauntlet.evaluate`: play a policy from Python."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.orchestrator.api.served_object import ServedObject
from robogauntlet.orchestrator.runs.composition import SEEDS, compose_plan
from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.observer import Observer
from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.runs.suite_policies import one_of_each_body
from robogauntlet.orchestrator.trackers import PROJECT, open_tracker
from robogauntlet.policies.contract import Policy
from robogauntlet.policies.references import read_reference, with_options
from robogauntlet.results.api import OpenRun, open_run
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.run_history import history_url
from robogauntlet.support.errors import BadInput, UserError


class EvaluationStopped(UserError):
    """The run ended early, for example because of too many errors; the message has the reason and the run folder."""


def evaluate(
    policy: str | Path | Policy | Callable[..., FloatArray],
    tasks: str | Sequence[str],
    seeds: int | None = None,
    conditions: str | Sequence[str] = "clean",
    out: Path | str | None = None,
    *,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
    identity: str | None = None,
    media: bool | None = False,
    tracker: str | None = None,
    project: str = PROJECT,
    quiet: bool = False,
    **settings: Any,
) -> OpenRun:
    """Play a policy and return its run, as `robogauntlet run` does without a suite file.

    Functions, classes and objects stay in this process, where a server on loopback answers the workers, one query at a
    time. They need not be importable, so they may be defined in a notebook. The function is asked once beforehand,
    about black images, so that an answer of a wrong shape is refused before anything starts.

    Args:
        policy: One of
            the text that the command line takes (`oracle`, `openpi://HOST:PORT`, `python:MODULE:NAME`,
            `lerobot:FOLDER`, `zoo:NAME`, a folder);
            a function of `images` (camera to (size, size, 3) uint8), `proprioception` ((8,) float64) and `instruction`
            (text) that returns an action chunk (n, 7), see `robogauntlet.adapters.contract`;
            an object with such a `__call__`, whose `reset()`, if it has one, is called at the start of each episode;
            its class; or a policy of `robogauntlet.policies.contract`.
        tasks: A task, `simulator/task`, or a pattern such as `pybullet/*`; or several.
        seeds: Number of seeds, from 0; by default 20, or as many as the tasks have stored states.
        conditions: `AXIS` for all severities of a perturbation axis, `AXIS@SEVERITY[,SEVERITY]`, or `clean`, which is
            always included; or several.
        out: Run folder; by default a new one below `runs/`. A run of the same policy and tasks that is in it is
            continued.
        name: The policy's name in the run; by default made of the text, or that of the function or class.
        options: Options of a policy that is named by a text, such as `{"convention": "libero"}`.
        identity: What identifies the content of an object, such as the name or hash of its checkpoint. By default it is
            the source of a function that uses nothing but its parameters and installed modules. Any other object counts
            as a new policy at each call, so that its run cannot be continued.
        media: Record videos after the episodes: all (True), none (False), or a failure of each policy and what fits
            into a fifth of the playing time (None).
        tracker: An experiment tracker, `wandb` or `mlflow`, that receives progress, results and videos.
        project: Project of W&B, experiment of MLflow.
        quiet: Print no progress.
        **settings: Further keys of a suite, such as `image_size=224` or `workers=2`.

    Raises:
        BadInput: Something does not exist, or is not as described. Nothing is started.
        PolicyError: The policy cannot be used. Nothing is started.
        PlanError: The run cannot be started, or `out` holds another run.
        EvaluationStopped: The run ended early.
    """
    listed, shifts = _texts("tasks", tasks, "a task"), _texts("conditions", conditions, "a condition")
    if isinstance(seeds, bool) or not isinstance(seeds, int | None):
        raise BadInput(f"seeds: expected their number, such as {SEEDS}, got {seeds!r}")
    with ExitStack() as stack:
        display = ProgressDisplay(Console(quiet=quiet))
        trackers = [] if tracker is None else [open_tracker(tracker, project, display.log)]
        served: ServedObject | None = None
        if isinstance(policy, str | Path):
            if identity is not None:
                raise BadInput("identity: expected with a function or object only; give it as an option")
            (entry,) = with_options([read_reference(str(policy))], options or {})
            entry = entry.model_copy(update={"name": name or entry.name})
        else:
            if options:
                raise BadInput("options: expected with the name of a policy only, got a function or object")
            served = stack.enter_context(ServedObject(policy, name=name, identity=identity))
            entry = served.entry
            settings = {"workers": 1, **settings} if served.is_sequential else settings
        folder = None if out is None else Path(out)
        plan, folder = compose_plan([entry], listed, seeds=seeds, conditions=shifts, folder=folder, settings=settings)
        if served is not None:
            _check(served, plan)
        return _play(plan, folder, media, [display, *trackers])


def _texts(name: str, given: str | Sequence[str], one: str) -> list[str]:
    """The argument as a list. Raises BadInput if it is neither a text nor texts."""
    listed = [given] if isinstance(given, str) or not isinstance(given, Iterable) else list(given)
    if not all(isinstance(text, str) for text in listed):
        raise BadInput(f"{name}: expected {one}, or a list of them, got {given!r}")
    return listed


def _check(served: ServedObject, plan: Plan) -> None:
    """Refuse an object that cannot play the plan."""
    suite = plan.suite
    if served.is_sequential and (suite.workers != 1 or len(plan.simulators) > 1):
        raise BadInput(
            f"policy '{served.name}': an object with reset plays one episode at a time, expected tasks of one "
            "simulator and no other workers than 1; give its class instead, of which each episode gets an object"
        )
    for task in one_of_each_body(suite.tasks):
        served.check_answer(suite.view, task)


def _play(plan: Plan, folder: Path, media: bool | None, observers: Sequence[Observer]) -> OpenRun:
    history = history_url(os.environ.get("ROBOGAUNTLET_HISTORY") or None, folder.absolute().parent)
    outcome = run_plan(plan, folder, RunOptions(media=media), [*observers, HistoryObserver(history, folder)])
    for warning in outcome.warnings:
        warnings.warn(warning, stacklevel=3)
    if outcome.document.status is RunStatus.INTERRUPTED or outcome.media_interrupted:
        raise KeyboardInterrupt
    if outcome.document.status is RunStatus.STOPPED:
        raise EvaluationStopped(f"{folder}: {outcome.document.reason}")
    return open_run(folder)
