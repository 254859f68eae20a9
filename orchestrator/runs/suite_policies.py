"""The second step of a plan: what each policy of a suite is built from and asks for, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeGuard

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import ObservationSpec, TaskDescription
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.planned_policy import PlannedPolicy
from robogauntlet.orchestrator.runs.suite_names import of_tasks
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import (
    Contact,
    PolicyError,
    PolicyMismatch,
    PolicyNotInstalled,
    PolicySpec,
    PolicyUnreachable,
    Wishes,
    check_fit,
    check_tasks,
)
from robogauntlet.policies.hub import OnHub, without_downloads
from robogauntlet.suites.loading import Problem, policy_lines, problem_at
from robogauntlet.suites.ranges import LARGEST_IMAGE, SMALLEST_IMAGE
from robogauntlet.suites.schema import PolicyEntry, Suite

NOT_STARTED = "nothing that a suite names is imported or contacted; --start does"
"""Why a policy was not checked."""
NO_WISHES = Wishes()


@dataclass(frozen=True)
class SuitePolicies:
    """The policies of a suite."""

    suite: Suite
    """The suite, with what its policies ask for where it states nothing, and fitted to them if that was asked for."""
    sources: Mapping[str, PolicySource]
    unchecked: Mapping[str, str]
    """Policies of which it is unknown whether they fit the suite, each with the reason."""
    mistakes: Sequence[tuple[str, str]]
    """Name and message of each that cannot be used."""
    notes: tuple[str, ...] = ()
    """What of the suite was chosen as they ask, a line each."""
    warnings: tuple[str, ...] = ()
    """What they ask for in vain, and what cannot be told of them, a line each."""
    server_metadata: Mapping[str, str] = field(default_factory=dict)
    """Policies with an identity to the hash of what their servers say of themselves."""

    def problems(self, path: Path, text: str) -> list[Problem]:
        """The mistakes with their lines in the suite file of this text."""
        lines = policy_lines(text)
        return [problem_at(path, lines.get(name), message) for name, message in self.mistakes]


def resolve_policies(
    suite: Suite, environments: EnvironmentResolver, *, start: bool, required: bool = False, fit: bool = False
) -> SuitePolicies:
    """Find what each policy of a suite is built from.

    Args:
        suite: The suite.
        environments: The environments of policies.
        start: Whether to import code that the suite names, contact its servers and start interpreters.
        required: Whether each must be usable now: what cannot be checked is a mistake, and functions are asked once.
        fit: Whether the suite leaves out tasks in which one of its policies cannot act, and takes the image size that
            the only one needs that is no reference policy, also where it states another.
    """
    given, unchecked, found = suite, {}, {}
    mistakes: dict[str, list[str]] = {entry.name: [] for entry in suite.policies}
    names_by_digest: dict[str, str] = {}

    @contextmanager
    def noting_mistakes(name: str) -> Iterator[None]:
        try:
            yield
        except PolicyMismatch as error:
            mistakes[name].append(f"policy '{name}' does not fit: {error.reason}")
        except PolicyError as error:
            mistakes[name].append(f"policy '{name}': {error.reason}")

    with ExitStack() as processes:
        for entry in suite.policies:
            with noting_mistakes(entry.name):
                one = found[entry.name] = (_find if start else _find_without_start)(entry, environments)
                if one.process is not None:
                    processes.callback(one.process.close)
                suite = _fitted(suite, entry, one.spec) if fit and one.spec is not None else suite
        suite, notes, warnings = _as_wished(suite, found)
        contacts = {name: one.contact for name, one in found.items() if one.contact is not None}
        warnings += [f"policy '{name}' {contact.warning}" for name, contact in contacts.items() if contact.warning]
        metadata = {name: contact.metadata for name, contact in contacts.items() if contact.metadata is not None}
        if suite.image_size != given.image_size and "image_size" in given.model_fields_set:
            notes.append(f"images of {suite.image_size} px, which the policy needs, instead of {given.image_size} px")
        for name, one in found.items():
            with noting_mistakes(name):
                if one.spec is not None:
                    _check_fit(one.spec, suite)
                if required and one.process is not None:
                    for task in one_of_each_body(suite.tasks):
                        one.process.check_answer(suite.view, task)
            if one.reason:
                unchecked[name] = one.reason
            if one.source.digest is None or mistakes[name]:
                continue
            if (first := names_by_digest.setdefault(str(one.source.digest), name)) != name:
                mistakes[name].append(f"policies '{first}' and '{name}' are the same policy; remove one")
    sources = {name: one.source for name, one in found.items()}
    listed = [(name, f"policy '{name}': {reason}") for name, reason in unchecked.items() if required]
    listed += [(name, message) for name, messages in mistakes.items() for message in messages]
    return SuitePolicies(suite, sources, unchecked, listed, tuple(notes), tuple(warnings), metadata)


@dataclass(frozen=True)
class _Found:
    """What is known of a policy."""

    source: PolicySource
    reason: str = ""
    """Why it was not checked ("" if it was)."""
    spec: PolicySpec | None = None
    wishes: Wishes = NO_WISHES
    process: PlannedPolicy | None = None
    """In which it was imported, if it is code of the user."""
    contact: Contact | None = None
    """What its server says, if it was asked."""


def _find(entry: PolicyEntry, environments: EnvironmentResolver) -> _Found:
    """Find what a policy is built from, and what it needs.

    Raises:
        PolicyError: The policy cannot be used.
        PolicyMismatch: Its options do not fit each other.
    """
    kind = policies.find(entry.kind)
    try:
        options = environments.options(entry.kind, entry.options)
    except PolicyNotInstalled as error:
        try:
            with without_downloads():
                digest = (kind.digest_without_start or kind.digest)(entry.options)
                wishes = policies.wishes(entry.kind, entry.options)
        except (PolicyNotInstalled, OnHub):
            raise error from None
        return _Found(PolicySource(entry.kind, entry.options, digest), str(error), wishes=wishes)
    wishes, contact = policies.wishes(entry.kind, options), Contact(options)
    if kind.contact is not None:
        with suppress(PolicyUnreachable):  # asking for its hash says so, unless it has an identity
            contact = kind.contact(options)
    options = contact.options
    try:
        source = PolicySource(entry.kind, options, policies.digest(entry.kind, options))
    except PolicyUnreachable as error:
        return _Found(PolicySource(entry.kind, options), str(error), wishes=wishes)
    try:
        process = PlannedPolicy(entry.name, source) if kind.imports_code else None
        spec = policies.spec(entry.kind, options) if process is None else process.spec
    except PolicyNotInstalled as error:
        return _Found(source, str(error), wishes=wishes)
    return _Found(source, "", spec, wishes, process, contact)


def _find_without_start(entry: PolicyEntry, environments: EnvironmentResolver) -> _Found:
    """The same, without importing, contacting or starting anything that the suite names."""
    kind, reason, digest, wishes = policies.find(entry.kind), "", None, NO_WISHES
    if kind.digest_without_start:
        has_own = bool(kind.requirements or kind.without_dependencies) and "python" not in entry.options
        reason = (environments.missing_file(kind) if has_own else None) or NOT_STARTED
    try:
        with without_downloads():
            digest = (kind.digest_without_start or kind.digest)(entry.options)
            wishes = policies.wishes(entry.kind, entry.options)
            spec = None if reason else policies.spec(entry.kind, entry.options)
    except OnHub:
        return _Found(PolicySource(entry.kind, entry.options), reason or NOT_STARTED)
    except PolicyNotInstalled as error:
        digest, spec, reason = kind.digest(entry.options) if digest is None else digest, None, str(error)
    return _Found(PolicySource(entry.kind, entry.options, digest), reason, spec, wishes)


def _fitted(suite: Suite, entry: PolicyEntry, spec: PolicySpec) -> Suite:
    """The suite without the tasks in which a policy cannot act, in its image size if no other is measured."""
    measured = [policy.name for policy in suite.policies if policy.name not in suite.reference_policies]
    if measured == [entry.name] and "image_size" in suite.model_fields_set and _is_image_size(spec.image_size):
        suite = suite.model_copy(update={"image_size": spec.image_size})
    return of_tasks(suite, spec.can_act_in)


def _is_image_size(size: int | None) -> TypeGuard[int]:
    return size is not None and SMALLEST_IMAGE <= size <= LARGEST_IMAGE


def _as_wished(suite: Suite, found: Mapping[str, _Found]) -> tuple[Suite, list[str], list[str]]:
    """The suite with what its policies ask for where it states nothing; what was chosen, and what they do not get.

    All policies play the same episodes, or they would be no pairs: frames have the size that is needed, or the largest
    that is asked for, and as many actions are executed as the one asks that asks for most.
    """
    notes, warnings = [], []
    needed = {name: size for name, one in found.items() if one.spec and _is_image_size(size := one.spec.image_size)}
    asked = {name: size for name, one in found.items() if _is_image_size(size := one.wishes.image_size)}
    sizes, remedy = needed or asked, "play it in another suite" if needed else "set image_size: {}"
    if "image_size" in suite.model_fields_set:
        remedy = "set image_size: {}"
    elif sizes:
        first = max(sizes, key=lambda name: sizes[name])
        smaller = [f"'{name}' asks for {size}" for name, size in (asked | needed).items() if size < sizes[first]]
        if sizes[first] != suite.image_size or smaller:
            others = f"; all policies play the same episodes, {', '.join(smaller)}" if smaller else ""
            notes.append(f"frames are rendered at {sizes[first]} px, as policy '{first}' asks{others}")
        suite = suite.model_copy(update={"image_size": sizes[first]})
    warnings += [
        f"frames are rendered at {suite.image_size} px and enlarged to {size} for policy '{name}'; "
        + remedy.format(size)
        for name, size in asked.items()
        if size > suite.image_size
    ]
    counts = {name: one.wishes.execute for name, one in found.items() if one.wishes.execute is not None}
    most = max(counts, key=lambda name: counts[name], default="")
    if "replan_every" not in suite.model_fields_set and counts and counts[most] > suite.replan_every:
        suite = suite.model_copy(update={"replan_every": counts[most]})
        notes.append(f"replan_every is {counts[most]} for all policies, as policy '{most}' asks")
    warnings += [
        f"replan_every: {suite.replan_every} is smaller than the {count} actions of a chunk that policy '{name}' asks "
        f"to execute; set replan_every: {count}"
        for name, count in counts.items()
        if count > suite.replan_every
    ]
    return suite, notes, warnings


def one_of_each_body(tasks: Iterable[str]) -> list[TaskDescription]:
    """Return the first of these tasks that has one arm, the first that has two, and the first of each with joints."""
    known = simulators.task_descriptions()
    return list({known[task].body: known[task] for task in reversed(list(tasks))}.values())


def _check_fit(spec: PolicySpec, suite: Suite) -> None:
    check_fit(spec, simulators.stand_in_spec(suite.tasks[0]), ObservationSpec(suite.cameras, suite.image_size))
    check_tasks(spec, suite.tasks)
