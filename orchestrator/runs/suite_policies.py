"""Finds the policies of a suite: what the command line adds, what each is built from, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import ActionSpec, Joint, ObservationSpec, TaskDescription
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.first_answer import check_first_answer
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import (
    PolicyError,
    PolicyMismatch,
    PolicyNotInstalled,
    PolicySpec,
    PolicyUnreachable,
    check_fit,
    check_tasks,
)
from robogauntlet.policies.function_policy import FunctionPolicy, StatefulFunctionPolicy
from robogauntlet.policies.hub import OnHub, without_downloads
from robogauntlet.policies.references import FORMS, read_reference, with_options
from robogauntlet.suites.loading import Problem, policy_lines, problem_at
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.ranges import LARGEST_IMAGE, SMALLEST_IMAGE
from robogauntlet.suites.schema import PolicyEntry, Suite
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput, UserError

NOT_STARTED = "nothing that a suite names is imported or contacted; --check does"
"""Why a policy was not checked."""


class PlanError(UserError):
    """A suite that cannot be run; one line per problem."""


@dataclass(frozen=True)
class SuitePolicies:
    """The policies of a suite."""

    suite: Suite
    """The suite, fitted to its policies if that was asked for."""
    sources: Mapping[str, PolicySource]
    unchecked: Mapping[str, str]
    """Policies of which it is unknown whether they fit the suite, each with the reason."""
    mistakes: Sequence[tuple[str, str]]
    """Name and message of each that cannot be used."""

    def problems(self, path: Path, text: str) -> list[Problem]:
        """The mistakes with their lines in the suite file of this text."""
        lines = policy_lines(text)
        return [problem_at(path, lines.get(name), message) for name, message in self.mistakes]


def needs_policy(path: Path) -> str:
    """The message for a suite that is used without the policy that it needs."""
    return f"{path}: the suite needs a policy; add --policy with {FORMS}"


def add_policies(suite: Suite, part: SuiteSelection, path: Path) -> tuple[Suite, SuiteSelection]:
    """Add the policies of `part` that the suite lacks, and return both; `part` then has the names of these policies.

    Raises:
        PlanError: A name that is neither a policy of the suite nor a reference.
        BadInput: There is no such policy.
        PolicyError: The zoo has no such checkpoint.
    """
    entries, chosen = {policy.name: policy for policy in suite.policies}, []
    for text in part.policies:
        if any(fnmatchcase(name, text) for name in entries):
            chosen.append(text)
            continue
        try:
            entry = read_reference(text)
        except BadInput:
            if entries and not set(text) & set(":/"):
                raise PlanError(f"{path}: the suite has no policy '{text}'{did_you_mean(text, entries)}") from None
            raise
        if entries.setdefault(entry.name, entry) != entry:
            raise BadInput(
                f"--policy {text}: another policy has the name '{entry.name}' too; name them in a suite file"
            )
        chosen.append(entry.name)
    own = [policy.name for policy in suite.policies]
    if added := [entry for name, entry in entries.items() if name not in own]:
        listed = (*suite.policies, *with_options(added, part.options))
        if suite.needs is not None:
            chosen += own
            listed = (*listed[len(own) :], *suite.policies)
        suite = suite.model_copy(update={"policies": listed, "needs": None})
    elif part.options:
        raise BadInput("--option: expected --policy with a policy that the suite lacks, to which the option belongs")
    return suite, replace(part, policies=tuple(chosen))


def find_policies(
    suite: Suite,
    environments: EnvironmentResolver,
    *,
    start: bool,
    ask: bool = False,
    fit: bool = False,
    tasks_are_known: bool = True,
) -> SuitePolicies:
    """Find what each policy of a suite is built from.

    Args:
        suite: The suite.
        environments: The environments of policies.
        start: Whether to import code that the suite names, contact its servers and start interpreters.
        ask: Whether to ask functions once.
        fit: Whether the suite leaves out tasks in which one of its policies cannot act, and takes the image size of the
            only one that is no reference policy, which then comes first.
        tasks_are_known: Whether a policy that does not fit the suite is a mistake; not where tasks stand in for wrong
            ones.
    """
    sources: dict[str, PolicySource] = {}
    unchecked: dict[str, str] = {}
    mistakes: list[tuple[str, str]] = []
    names_by_digest: dict[str, str] = {}
    for entry in suite.policies:
        try:
            source, reason, suite = (
                _find(entry, suite, environments, ask=ask, fit=fit)
                if start
                else _find_without_start(entry, suite, environments, fit=fit)
            )
        except PolicyMismatch as error:
            if tasks_are_known:
                mistakes.append((entry.name, f"policy '{entry.name}' does not fit: {error.reason}"))
            continue
        except PolicyError as error:
            mistakes.append((entry.name, f"policy '{entry.name}': {error.reason}"))
            continue
        sources[entry.name] = source
        if reason:
            unchecked[entry.name] = reason
        if source.digest is None:
            continue
        if (first := names_by_digest.setdefault(str(source.digest), entry.name)) != entry.name:
            mistakes.append((entry.name, f"policies '{first}' and '{entry.name}' are the same policy; remove one"))
    return SuitePolicies(suite, sources, unchecked, mistakes)


def _find(
    entry: PolicyEntry, suite: Suite, environments: EnvironmentResolver, *, ask: bool, fit: bool
) -> tuple[PolicySource, str, Suite]:
    """Find what a policy is built from, why it was not checked ("" if it was), and the suite, fitted if `fit`.

    Raises:
        PolicyError: The policy cannot be used.
        PolicyMismatch: It does not fit the suite.
    """
    kind = policies.find(entry.kind)
    try:
        options = environments.options(entry.kind, entry.options)
    except PolicyNotInstalled as error:
        try:
            with without_downloads():
                digest = (kind.digest_without_start or kind.digest)(entry.options)
        except (PolicyNotInstalled, OnHub):
            raise error from None
        return PolicySource(entry.kind, entry.options, digest), str(error), suite
    try:
        source = PolicySource(entry.kind, options, policies.digest(entry.kind, options))
    except PolicyUnreachable as error:
        return PolicySource(entry.kind, options), str(error), suite
    try:
        policy = None if kind.spec else policies.load(entry.kind, options)
        spec = policies.spec(entry.kind, options) if policy is None else policy.spec
    except PolicyNotInstalled as error:
        return source, str(error), suite
    suite = _fitted(suite, entry, spec) if fit else suite
    _check_fit(spec, suite)
    if ask and isinstance(policy, FunctionPolicy | StatefulFunctionPolicy):
        for task in one_of_each_body(suite.tasks):
            check_first_answer(entry.name, policy.ask, suite.view, task)
    return source, "", suite


def _find_without_start(
    entry: PolicyEntry, suite: Suite, environments: EnvironmentResolver, *, fit: bool
) -> tuple[PolicySource, str, Suite]:
    """The same, without importing, contacting or starting anything that the suite names."""
    kind, reason, digest = policies.find(entry.kind), "", None
    if kind.digest_without_start:
        has_own = bool(kind.requirements or kind.without_dependencies) and "python" not in entry.options
        reason = (environments.missing_file(kind) if has_own else None) or NOT_STARTED
    try:
        with without_downloads():
            digest = (kind.digest_without_start or kind.digest)(entry.options)
            spec = None if reason else policies.spec(entry.kind, entry.options)
    except OnHub:
        return PolicySource(entry.kind, entry.options), reason or NOT_STARTED, suite
    except PolicyNotInstalled as error:
        digest, spec, reason = kind.digest(entry.options) if digest is None else digest, None, str(error)
    if spec is not None:
        suite = _fitted(suite, entry, spec) if fit else suite
        _check_fit(spec, suite)
    return PolicySource(entry.kind, entry.options, digest), reason, suite


def _fitted(suite: Suite, entry: PolicyEntry, spec: PolicySpec) -> Suite:
    """The suite without the tasks in which a policy cannot act, in its image size if no other is measured."""
    measured = [policy.name for policy in suite.policies if policy.name not in suite.reference_policies]
    size = spec.image_size if measured == [entry.name] else None
    if size is not None and SMALLEST_IMAGE <= size <= LARGEST_IMAGE:
        suite = suite.model_copy(update={"image_size": size})
    return of_tasks(suite, spec.can_act_in)


def one_of_each_body(tasks: Iterable[str]) -> list[TaskDescription]:
    """Return the first of these tasks that has one arm, the first that has two, and the first of each with joints."""
    known = simulators.task_descriptions()
    return list({known[task].body: known[task] for task in reversed(list(tasks))}.values())


def of_tasks(suite: Suite, able: Callable[[str], bool]) -> Suite:
    """Return the suite with those of its tasks that are `able`; the whole suite if none is."""
    return suite.model_copy(update={"tasks": tuple(filter(able, suite.tasks)) or suite.tasks})


def _check_fit(spec: PolicySpec, suite: Suite) -> None:
    body = simulators.body_of(suite.tasks[0])
    joints = tuple(Joint(name, -1.0, 1.0, 1.0) for name in body.joints)
    actions = ActionSpec(1.0, 1.0, 1.0, arms=body.arms, joints=joints)
    check_fit(spec, actions, ObservationSpec(suite.cameras, suite.image_size))
    check_tasks(spec, suite.tasks)
