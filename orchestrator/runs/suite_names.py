"""The first step of a plan: a suite in which every name exists, with what the command line adds to its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

from robogauntlet.policies.references import FORMS, read_reference, with_options
from robogauntlet.suites.checks import check_names
from robogauntlet.suites.loading import SuiteError, load_suite, problem_at
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.registry import Registry
from robogauntlet.suites.schema import Suite
from robogauntlet.suites.selection import SelectionError, SuiteSelection
from robogauntlet.support.errors import BadInput, UserError


class PlanError(UserError):
    """A suite that cannot be run; one line per problem."""


@dataclass(frozen=True)
class SuiteNames:
    """A suite whose names exist."""

    suite: Suite
    """The chosen part of the file, with the policies of the command line."""
    is_open: bool
    """Whether the file left its policy to the command line, so that the suite is fitted to the one that it got."""
    tasks: tuple[str, ...]
    """The chosen tasks, also those in which a kind of policy cannot act, which the suite then lacks."""


def resolve_names(
    path: Path, text: str | None, part: SuiteSelection, names: Registry, *, require_policy: bool
) -> SuiteNames:
    """Read a suite file, add the policies of `part` and choose this part. For the arguments see `make_plan`.

    Raises:
        SuiteError: The file is wrong, or an added policy names what does not exist.
        PlanError: The part does not fit the file; with `require_policy`, the suite still needs a policy.
        BadInput: The part names a policy that does not exist.
        PolicyError: The part names a checkpoint of the zoo that does not exist.
    """
    loaded = load_suite(path, names, text)
    try:
        whole, part = add_policies(part.set_in(loaded), part, path)
        if require_policy and whole.needs is not None:
            raise PlanError(needs_policy(path, part.policies))
        suite = part.apply_to(whole)
    except SelectionError as error:
        raise PlanError(f"{path}: {error}") from None
    is_open, chosen = loaded.needs is not None, suite.tasks
    if is_open:
        for entry in suite.policies:
            if (known := names.policies.get(entry.kind)) and known.tasks is not None:
                suite = of_tasks(suite, known.tasks.__contains__)
    if mistakes := check_names(suite, names):  # of added policies
        raise SuiteError([problem_at(path, None, message) for _, message in mistakes])
    return SuiteNames(suite, is_open, chosen)


def needs_policy(path: Path, given: Sequence[str] = ()) -> str:
    """The message for a suite that is used without the policy that it needs, or with `given` that it has already."""
    named = "', '".join(given)
    own = f"'{named}' is its gate or baseline already, name another policy: " if given else ""
    return f"{path}: {own}the suite needs a policy; add --policy with {FORMS}"


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
    for entry in part.added:
        if entries.setdefault(entry.name, entry) != entry:
            raise BadInput(f"{path}: expected no policy '{entry.name}' in the suite, it has one; rename one of them")
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


def of_tasks(suite: Suite, able: Callable[[str], bool]) -> Suite:
    """Return the suite with those of its tasks that are `able`; the whole suite if none is."""
    return suite.model_copy(update={"tasks": tuple(filter(able, suite.tasks)) or suite.tasks})
