"""Plays the episodes of a search for worst cases: each round is a run in a folder of its own, so that none is lost."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.orchestrator.registry import why_impossible
from robogauntlet.orchestrator.runs.composition import compose_plan
from robogauntlet.orchestrator.runs.plan import Plan, check_same
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.results.folder_lock import LOCK_FILE, FolderError, lock_folder
from robogauntlet.results.record import Status
from robogauntlet.results.report.worst_cases import plain_cases
from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run
from robogauntlet.results.statistics.boundary import Trials
from robogauntlet.results.statistics.worst_case import (
    LEAST_STATES,
    MOST_EPISODES,
    Answer,
    Point,
    Round,
    SearchSpace,
    WorstCases,
    least_budget,
    search_worst_cases,
)
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.axes import AXES, LATENCY, why_exclusive
from robogauntlet.suites.episode import CONTROLS, Condition, Perturbation, SuccessRule
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import PolicyEntry, valid_name
from robogauntlet.suites.timing import TimingMode
from robogauntlet.support.errors import BadInput, UserError, describe_os_error
from robogauntlet.support.files import read_regular, write_whole
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.text import counted

SEARCH_FILE = "search.json"
"""The arguments of a search in its folder, and at the end what it found."""
SCALED = tuple(name for name in AXES if name not in CONTROLS)
"""Axes that have severities."""
BY_DEFAULT = tuple(name for name in SCALED if LATENCY.get(name) in (None, TimingMode.HOLD))
"""Those that are searched if none is named: of the axes of latency, that in which the robot holds."""


class SearchStopped(UserError):
    """A round could not be played to its end; the message has the reason and the folder."""


@dataclass(frozen=True)
class SearchRequest:
    """What is searched for, and with how many episodes."""

    policy: PolicyEntry
    tasks: tuple[str, ...]
    axes: tuple[str, ...]
    """Those to search, or none for all that a task can have."""
    budget: int
    """Episodes in all, shared equally by the tasks."""
    below: float
    """The share of the clean rate below which the policy counts as broken."""
    seed: int
    success: SuccessRule | None = None
    """When an episode is a success; by default as in suites."""


@dataclass(frozen=True)
class TaskSearch:
    """The search on one task."""

    task: str
    axes: tuple[str, ...]
    budget: int
    skipped: dict[str, str] = field(default_factory=dict)
    """Axes that the task cannot have, each with the reason."""
    start_states: int | None = None
    """Stored states among which seeds choose, or None."""


@dataclass(frozen=True)
class SearchedTask:
    """What was found on one task."""

    search: TaskSearch
    found: WorstCases
    errors: int
    """Episodes that could not be played."""

    def plain(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        found = plain_cases(self.found)
        return {"task": self.search.task, "skipped": self.search.skipped, "errors": self.errors, **found}


def plan_search(request: SearchRequest) -> list[TaskSearch]:
    """Check a request and share its budget. Starts and writes nothing.

    Raises:
        BadInput: Something does not exist, a task cannot have a named axis, or the budget is too small.
        PlanError: A simulator is not available.
    """
    for number, name in enumerate(request.axes):
        if name not in SCALED:
            raise BadInput(f"--axis: expected a perturbation axis, got '{name}'{did_you_mean(name, SCALED)}")
        if name in request.axes[:number]:
            raise BadInput(f"--axis: expected each axis once, got '{name}' twice")
    plan, _ = compose_plan([request.policy], request.tasks, seeds=1, folder=Path(SEARCH_FILE))
    if plan.unavailable:
        raise BadInput("\n".join(f"{name}: {reason}" for name, reason in plan.unavailable.items()))
    tasks = plan.suite.tasks
    searches = [_task_search(task, request.axes, request.budget // len(tasks)) for task in tasks]
    least = max(least_budget(len(one.axes)) for one in searches) * len(tasks)
    if request.budget < least:
        most = max(len(one.axes) for one in searches)
        fewer = "" if most == 1 else ", or fewer axes with --axis"
        wanted = f"{least} episodes for {counted(most, 'axis', 'axes')} on {counted(len(tasks), 'task')}"
        raise BadInput(f"--budget: expected at least {wanted}{fewer}, got {request.budget}")
    if request.budget // len(tasks) > MOST_EPISODES:
        raise BadInput(f"--budget: expected at most {MOST_EPISODES} episodes per task, got {request.budget}")
    return searches


def _task_search(task: str, named: Sequence[str], budget: int) -> TaskSearch:
    reasons = {name: why_impossible(Condition(name, 1), task) for name in named or BY_DEFAULT}
    skipped = {name: reason for name, reason in reasons.items() if reason}
    if named and skipped:
        raise BadInput("\n".join(f"--axis {name}: {task} cannot have it: {reason}" for name, reason in skipped.items()))
    states = task_descriptions()[task].start_states
    if states is not None and states < LEAST_STATES:
        raise BadInput(
            f"{task}: expected {LEAST_STATES} stored states or more to search on some and confirm on others, "
            f"it has {states}"
        )
    return TaskSearch(task, tuple(name for name in reasons if name not in skipped), budget, skipped, states)


def play_search(
    request: SearchRequest, searches: Sequence[TaskSearch], folder: Path, on_line: Callable[[str], None]
) -> list[SearchedTask]:
    """Search on all tasks in turn, and write `search.json` into the folder.

    Each round is a run in a subfolder. In the folder of an interrupted search of the same request, rounds that are
    complete are read, and the others continued. `on_line` gets a line per round.

    Raises:
        BadInput: The folder holds something else.
        SearchStopped: A round could not be played to its end.
        KeyboardInterrupt: The search was interrupted; it continues where it was.
        FolderError: The folder cannot be written, or another process writes into it.
    """
    with ExitStack() as stack:
        _claim(folder, request, stack)
        start_ray = cache(lambda: stack.enter_context(_ray()))
        found = [_TaskPlayer(request, search, folder, on_line, start_ray).play() for search in searches]
        _write(folder, {**_arguments(request), "status": "complete", "found": [one.plain() for one in found]})
    return found


def _ray() -> AbstractContextManager[None]:
    from robogauntlet.orchestrator.ray_runtime.session import ray_session

    return ray_session(address=None, workers=0)


def _claim(folder: Path, request: SearchRequest, stack: ExitStack) -> None:
    """Begin a search in a folder, or continue it."""
    file = folder / SEARCH_FILE
    if not file.exists() and folder.is_dir() and any(path.name != LOCK_FILE for path in folder.iterdir()):
        raise BadInput(f"{folder}: expected a new folder or that of a search, it has other files")
    stack.enter_context(lock_folder(folder))
    if not file.exists():
        _write(folder, {**_arguments(request), "status": "running"})
        return
    try:
        begun = parse_json(read_regular(file))
    except (OSError, ValueError) as error:
        raise BadInput(f"{file}: {error}") from None
    for name, value in _arguments(request).items():
        if not isinstance(begun, dict) or begun.get(name) != value:
            raise BadInput(f"{folder}: its search has another '{name}'; give another folder with --out")


def _arguments(request: SearchRequest) -> dict[str, Any]:
    plain = {**asdict(request), "policy": request.policy.model_dump(mode="json")}
    read: dict[str, Any] = json.loads(json.dumps(plain))
    return read


def _write(folder: Path, content: dict[str, Any]) -> None:
    try:
        write_whole(folder / SEARCH_FILE, json.dumps(content, indent=1) + "\n")
    except OSError as error:
        raise FolderError(f"{folder}: {describe_os_error(error)}") from None


class _TaskPlayer:
    """Plays the rounds of one task."""

    def __init__(
        self,
        request: SearchRequest,
        search: TaskSearch,
        folder: Path,
        on_line: Callable[[str], None],
        start_ray: Callable[[], None],
    ) -> None:
        self._request, self._search, self._on_line, self._start_ray = request, search, on_line, start_ray
        self._folder = folder / valid_name(search.task)
        self._rounds = self._played = self._errors = 0

    def play(self) -> SearchedTask:
        request, search = self._request, self._search
        whole = [name for name in search.axes if AXES[name].unchanged is None]
        space = SearchSpace(search.axes, whole, _combine, search.start_states)
        rounds = search_worst_cases(space, search.budget, below=request.below, seed=request.seed)
        try:
            asked = next(rounds)
            while True:
                asked = rounds.send(self._answer(asked))
        except StopIteration as end:
            return SearchedTask(search, end.value, self._errors)

    def _answer(self, asked: Round) -> Answer:
        self._rounds += 1
        folder = self._folder / f"round-{self._rounds:02}"
        conditions = {point: condition_at(point) for point in asked.points}
        plan, _ = compose_plan(
            [self._request.policy],
            [self._search.task],
            seeds=len(asked.seeds),
            first_seed=asked.seeds.start,
            conditions=[str(condition) for condition in conditions.values()],
            folder=folder,
            settings={"error_tolerance": 1.0} | ({"success": str(rule)} if (rule := self._request.success) else {}),
        )
        statuses = self._statuses(plan, folder)
        self._played += asked.episodes
        answer = {}
        for point, condition in conditions.items():
            found = statuses.get(condition, [])
            self._errors += found.count(Status.ERROR)
            won = found.count(Status.SUCCESS)
            answer[point] = Trials(won, won + found.count(Status.FAILURE))
        if not any(one.trials for one in answer.values()):
            raise SearchStopped(f"{folder}: every episode of the round ended in an error")
        clean = answer[()]
        where = f"{self._search.task}, round {self._rounds}, {asked.stage}"
        of_clean = f"clean {clean.successes} of {clean.trials}"
        self._on_line(f"{where}: {of_clean}; {self._played} of {self._search.budget} episodes")
        return answer

    def _statuses(self, plan: Plan, folder: Path) -> dict[Condition, list[str]]:
        """The outcome of each episode of the round by condition, played where it is missing."""
        document = read_run(folder) if (folder / RUN_FILE).exists() else None
        if document is not None and document.status is RunStatus.COMPLETE:
            check_same(plan, document, folder)
        else:
            self._start_ray()
            outcome = run_plan(plan, folder, RunOptions(media=False))
            document = outcome.document
            if document.status is RunStatus.INTERRUPTED:
                raise KeyboardInterrupt
            if document.status is not RunStatus.COMPLETE or document.skipped:
                reason = document.reason or "; ".join(document.skipped.values())
                raise SearchStopped(f"{folder}: {reason}")
        found: dict[Condition, list[str]] = {}
        with closing(Store.open_begun(folder, document)) as store:
            for (_, _, axis, severity), by_seed in store.outcomes().items():
                found[Condition(axis, severity)] = list(by_seed.values())
        return found


def _combine(names: Collection[str]) -> bool:
    return why_exclusive(names) is None


def condition_at(point: Point) -> Condition:
    """Return the condition of a point of the search."""
    return Condition.of(*(Perturbation(axis, severity) for axis, severity in point))
