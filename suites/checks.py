"""Checks of a suite against the names that exist, and against itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice

from robogauntlet.suites.axes import AXES, LATENCY, why_exclusive
from robogauntlet.suites.episode import (
    AT,
    CAMERAS,
    CLEAN,
    CONTROLS,
    FIRST_TRAINING_SEED,
    Condition,
    Perturbation,
    ProtocolName,
)
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import MAX_CELLS, MAX_COUNT, MAX_PATTERNS
from robogauntlet.suites.registry import Registry
from robogauntlet.suites.schema import Mistake, Suite, expand_tasks, is_plain, robots_by_task, with_robots

MOST_SEVERE = 5
"""Severity that no axis exceeds."""
LIBERO = ("libero", "libero-plus")
"""Simulators that can be played under the protocol `openvla`."""
MOST_MISTAKES = 100
"""Mistakes of a file that are shown."""


def check_names(suite: Suite, names: Registry) -> list[Mistake]:
    """Return a mistake for every name that does not exist and for every contradiction.

    Stops after one more than `MOST_MISTAKES`. A suite that is too large has that mistake alone.
    """
    distinct = Counter(suite.tasks)
    twice = next((task for task, times in distinct.items() if times > 1 and not is_plain(task)), None)
    if twice is not None:
        return [(("tasks",), f"duplicate pattern '{twice}', expected it once, got it {distinct[twice]} times")]
    if (patterns := sum(not is_plain(task) for task in distinct)) > MAX_PATTERNS:
        return [(("tasks",), f"expected at most {MAX_PATTERNS} patterns of tasks, got {patterns}; use wider ones")]
    matches = {pattern: expand_tasks([pattern], names.tasks) for pattern in distinct}
    tasks = [*chain.from_iterable(matches.values())]
    if too_large := [*_check_size(suite, len(tasks))]:
        return too_large
    mistakes = chain(
        _check_policies(suite, names),
        _check_tasks(suite, names, matches),
        _check_robots(suite, names, tasks),
        _check_conditions(suite, names),
        _check_design(suite, names),
        _check_cameras(suite),
        _check_protocol(suite, tasks),
        _check_timing(suite),
        _check_simulators(suite, names),
        _check_programs(suite, names),
        _check_roles(suite),
        _check_references(suite, names),
        _check_adaptive(suite),
        _check_seeds(suite, names, tasks),
    )
    return [*islice(mistakes, MOST_MISTAKES + 1)]


def _check_size(suite: Suite, tasks: int) -> Iterator[Mistake]:
    """What the suite expands to, counted without expanding it."""
    tasks *= max(1, len(suite.robots))
    policies = max(1, len(suite.policies))
    conditions = sum(len(entry.severities) for entry in suite.conditions)
    conditions += suite.design.conditions_planned if suite.design else 0
    cells = tasks * policies * conditions
    seeds = suite.seeds.count if suite.adaptive is None else suite.adaptive.max_seeds
    if cells > MAX_CELLS:
        yield (
            ("tasks",),
            f"expected at most {MAX_CELLS:,} combinations of task, policy and condition, got {tasks:,} x {policies:,} "
            f"x {conditions:,} = {cells:,}; divide the suite",
        )
    elif cells * seeds > MAX_COUNT:
        yield (
            ("seeds",),
            f"expected at most {MAX_COUNT:,} episodes, got {cells:,} combinations of task, policy and condition "
            f"x {seeds:,} seeds; ask for fewer seeds",
        )


def _check_policies(suite: Suite, names: Registry) -> Iterator[Mistake]:
    seen: dict[str, int] = {}
    for i, policy in enumerate(suite.policies):
        place = ("policies", i)
        known = names.policies.get(policy.kind)
        if known is None:
            remedy = names.separate.get(policy.kind)
            meant = did_you_mean(policy.kind, names.policies)
            kind = f"policy '{policy.kind}'"
            yield place, f"{kind} is not installed; {remedy}" if remedy else f"unknown {kind}{meant}"
        else:
            for option in policy.options:
                if option not in known.options:
                    yield place, f"policy '{policy.kind}' has no option '{option}'{did_you_mean(option, known.options)}"
        first = seen.setdefault(policy.name, i)
        if first != i:
            yield place, f"duplicate policy '{policy.name}', already at entry {first + 1}; give it another `name`"


def _check_tasks(suite: Suite, names: Registry, matches: Mapping[str, Sequence[str]]) -> Iterator[Mistake]:
    seen: set[str] = set()
    able = robots_by_task(names.tasks) if suite.robots else {}
    known = [(policy.name, names.policies.get(policy.kind)) for policy in suite.policies]
    limited = [(name, kind.tasks) for name, kind in known if kind and kind.tasks is not None]
    for i, pattern in enumerate(suite.tasks):
        place = ("tasks", i)
        tasks = [task for task in matches[pattern] if task in names.tasks]
        if not tasks:
            yield place, _unknown_task(pattern, names)
        for task in with_robots(tasks, suite.robots, able):
            if task in seen:
                yield place, f"duplicate task '{task}'"
            seen.add(task)
            for name, own in limited:
                if task not in own:
                    yield place, f"policy '{name}' cannot act in '{task}'"


def _check_robots(suite: Suite, names: Registry, expanded: Sequence[str]) -> Iterator[Mistake]:
    if not suite.robots:
        return
    tasks = [task for task in expanded if task in names.tasks]
    known = robots_by_task(names.tasks)
    if named := [task for task in tasks if AT in task]:
        yield ("robots",), f"expected tasks that name no robot beside robots, got '{named[0]}'"
        return
    for i, robot in enumerate(suite.robots):
        for task in tasks:
            able = known.get(task, {})
            if robot not in able:
                others = did_you_mean(robot, able) if able else "; it has one robot only"
                yield ("robots", i), f"'{robot}' cannot play '{task}'{others}"
                break


def _check_protocol(suite: Suite, tasks: Sequence[str]) -> Iterator[Mistake]:
    if suite.protocol is ProtocolName.OPENVLA:
        for task in tasks:
            if task.partition("/")[0] not in LIBERO:
                yield ("protocol",), f"expected openvla with tasks of LIBERO only, got {task}; leave it out"
                return


def _check_timing(suite: Suite) -> Iterator[Mistake]:
    if suite.timing is None:
        return
    axes = dict.fromkeys(part.axis for one in suite.all_conditions() for part in _parts(one) if part.axis in LATENCY)
    for axis in axes:
        if LATENCY[axis] is not suite.timing.mode:
            yield ("timing",), f"expected {LATENCY[axis]}, as the axis '{axis}' has it, got {suite.timing.mode}"


def _parts(condition: Condition) -> tuple[Perturbation, ...]:
    """What is perturbed; nothing if that is spelled wrongly, of which `_check_conditions` tells."""
    try:
        return condition.perturbations
    except ValueError:
        return ()


def _unknown_task(pattern: str, names: Registry) -> str:
    simulator, slash, _ = pattern.partition("/")
    if not slash:
        return f"expected simulator/task, got '{pattern}'{did_you_mean(pattern, names.public.tasks)}"
    if simulator not in names.simulators:
        return f"unknown simulator '{simulator}' in '{pattern}'{did_you_mean(simulator, names.public.simulators)}"
    tasks = [task for task in names.tasks if task.startswith(f"{simulator}/")]
    with_robot = [task for task in tasks if task.startswith(f"{pattern}{AT}")]
    return f"unknown task '{pattern}'{did_you_mean(pattern, with_robot or tasks)}"


def _check_conditions(suite: Suite, names: Registry) -> Iterator[Mistake]:
    seen: set[Condition] = set()
    for i, entry in enumerate(suite.conditions):
        place = ("conditions", i)
        for condition in entry.conditions():
            yield from ((place, mistake) for mistake in _mistakes_in(condition, names))
            if condition in seen:
                yield place, f"duplicate condition '{condition}'"
            seen.add(condition)
    if Condition() not in seen:
        yield ("conditions",), "no clean condition to compare the perturbed ones with; add clean"


def _mistakes_in(condition: Condition, names: Registry) -> Iterator[str]:
    """What is wrong with a condition: unknown axes, severities that they lack, axes that do not combine."""
    if condition.axis == CLEAN and condition.severity:
        yield "clean has severity 0 only"
        return
    if condition.axis != CLEAN and not condition.severity:
        axis = condition.axis
        known = axis in names.axes
        yield (
            f"expected severities above 0 for '{axis}', as {{axis: {axis}, severities: [2, 4]}}"
            if known
            else (f"unknown condition '{axis}'{did_you_mean(axis, [CLEAN, *names.axes])}")
        )
        return
    try:
        parts = condition.perturbations
    except ValueError as error:
        yield str(error)
        return
    for part in parts:
        highest = names.axes.get(part.axis, MOST_SEVERE)
        if part.axis not in names.axes:
            yield f"unknown condition '{part.axis}'{did_you_mean(part.axis, [CLEAN, *names.axes])}"
        elif not 0 < part.severity <= highest:
            yield f"'{part.axis}' has severity {highest} at most, got {part.severity:g}"
        elif not float(part.severity).is_integer() and AXES[part.axis].unchanged is None:
            yield f"'{part.axis}' has whole severities only, got {part.severity:g}"
    if reason := why_exclusive(part.axis for part in parts):
        yield reason


def _check_design(suite: Suite, names: Registry) -> Iterator[Mistake]:
    if suite.design is None:
        return
    axes = [axis for axis in names.axes if axis not in CONTROLS]
    for i, axis in enumerate(suite.design.axes):
        if axis not in axes:
            yield ("design", "axes", i), f"unknown axis '{axis}'{did_you_mean(axis, axes)}"
        else:
            whole = AXES[axis].unchanged is None
            wrong = [severity for severity in suite.design.severities or () if whole and severity % 1]
            if wrong:
                yield ("design", "severities"), f"'{axis}' has whole severities only, got {wrong[0]:g}"
    if suite.adaptive is not None:
        yield ("design",), "adaptive stops conditions one by one, a design needs all seeds of each; remove one of both"


def _check_cameras(suite: Suite) -> Iterator[Mistake]:
    for i, camera in enumerate(suite.cameras):
        if camera not in CAMERAS:
            yield ("cameras", i), f"unknown camera '{camera}'{did_you_mean(camera, CAMERAS)}"
        elif camera in suite.cameras[:i]:
            yield ("cameras", i), f"duplicate camera '{camera}'"


def _check_simulators(suite: Suite, names: Registry) -> Iterator[Mistake]:
    """Simulators in `workers`, `resources` and `environments`; the last may hold kinds of policies too."""
    kinds = [name for name, policy in names.policies.items() if policy.has_environment]
    keys: list[tuple[str, Iterable[str], list[str]]] = [
        ("workers", suite.workers if isinstance(suite.workers, dict) else (), []),
        ("resources", suite.resources, []),
        ("environments", suite.environments, kinds),
    ]
    for key, given, others in keys:
        for name in given:
            if name not in names.simulators and name not in others:
                near = did_you_mean(name, [*names.public.simulators, *others])
                yield (key, name), f"unknown simulator '{name}'{near}"


def _check_programs(suite: Suite, names: Registry) -> Iterator[Mistake]:
    """A suite names environments, never a program: interpreters come from the user's configuration only."""
    for name, environment in suite.environments.items():
        if environment.interpreter is not None:
            yield ("environments", name, "interpreter"), _NO_PROGRAM.format(name=name)
    for i, policy in enumerate(suite.policies):
        kind = names.policies.get(policy.kind)
        if kind is not None and kind.has_environment and "python" in policy.options:
            yield ("policies", i, "options", "python"), _NO_PROGRAM.format(name=policy.kind)


_NO_PROGRAM = (
    "a suite names no program: write `environments: {{{name}: {{interpreter: FILE}}}}` into your configuration "
    "(~/.config/robogauntlet/config.yaml, or the file that ROBOGAUNTLET_CONFIG names)"
)


def _check_roles(suite: Suite) -> Iterator[Mistake]:
    """Policies named in `oracle_gate`, `no_skill_baselines`, `merging` and `compare`."""
    known = {policy.name: i for i, policy in enumerate(suite.policies)}
    gate: list[Mistake] = [(("oracle_gate",), suite.oracle_gate)] if suite.oracle_gate is not None else []
    baselines = [(("no_skill_baselines", i), name) for i, name in enumerate(suite.no_skill_baselines)]
    sides = [entry.places() for entry in (suite.merging, suite.compare) if entry]
    if suite.needs is not None:
        references = set(suite.reference_policies)
        for name, i in known.items():
            if name not in references:
                yield (
                    ("policies", i),
                    f"'{name}': expected none but those of oracle_gate and no_skill_baselines beside needs: policy",
                )
    for place, name in chain(gate, baselines, *sides):
        if name not in known:
            yield place, f"{place[0]} names no policy of this suite: '{name}'{did_you_mean(name, known)}"
    for places in sides:
        named: set[str] = set()
        for place, name in places:
            if name in known and name in named:
                yield place, f"{place[0]} names policy '{name}' twice; each side is another policy"
            named.add(name)


def _check_references(suite: Suite, names: Registry) -> Iterator[Mistake]:
    """The oracle gate and the baselines without skill against each other and their kinds."""
    gate, baselines = suite.oracle_gate, suite.no_skill_baselines
    for policy in suite.policies:
        known = names.policies.get(policy.kind)
        if policy.name == gate and known is not None and known.no_skill:
            yield ("oracle_gate",), f"oracle_gate: expected an oracle, '{gate}' is a baseline without skill"
    for i, name in enumerate(baselines):
        place = ("no_skill_baselines", i)
        if baselines.index(name) < i:
            yield place, f"no_skill_baselines: duplicate policy '{name}'"
        elif name == gate:
            yield place, f"no_skill_baselines: '{name}' is the oracle gate; expected another policy"
    others = {policy.name for policy in suite.policies} - set(baselines)
    if suite.needs is None and suite.policies and not others:
        yield ("no_skill_baselines",), "no_skill_baselines: expected a policy beside the baselines, got none"


def _check_adaptive(suite: Suite) -> Iterator[Mistake]:
    if suite.adaptive is None:
        return
    if suite.comparison is None:
        yield ("adaptive",), "nothing to decide; add compare: {baseline: POLICY, others: [POLICY]}"
    if suite.adaptive.max_seeds < suite.seeds.count:
        yield ("adaptive", "max_seeds"), f"expected {suite.seeds.count} seeds or more, got {suite.adaptive.max_seeds}"
    if "round" in suite.adaptive.model_fields_set and suite.adaptive.round > suite.adaptive.max_seeds:
        yield (
            ("adaptive", "round"),
            f"adaptive.round: expected {suite.adaptive.max_seeds} seeds at most, got {suite.adaptive.round}",
        )


def _check_seeds(suite: Suite, names: Registry, tasks: Sequence[str]) -> Iterator[Mistake]:
    """Seeds that would start as others of the same task do."""
    known = (name for name in tasks if name in names.tasks)
    played = range(suite.seeds.start, suite.seeds.start + suite.seeds.count)
    most = played if suite.adaptive is None else range(played.start, played.start + suite.adaptive.max_seeds)
    for task in known:
        if why := names.tasks[task].why_repeated(played):
            yield ("seeds",), f"{task}: {why}"
            return
        if why := names.tasks[task].why_repeated(most):
            yield ("adaptive", "max_seeds"), f"{task}: {why}"
            return


def training_seeds(suite: Suite) -> str | None:
    """Return a warning if the suite plays seeds that are for training and development, else None."""
    count = suite.seeds.count if suite.adaptive is None else suite.adaptive.max_seeds
    last = suite.seeds.start + count - 1
    if last < FIRST_TRAINING_SEED:
        return None
    return (
        f"seeds {suite.seeds.start} to {last}: those from {FIRST_TRAINING_SEED} on are for training and development, "
        "and a policy that was trained on them has seen them"
    )
