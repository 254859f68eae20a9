"""Selection of some policies, tasks or seeds of a suite, whose episodes keep their ids unless a setting changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import CompareEntry, MergingEntry, PolicyEntry, Seeds, Suite

REPLACING = ("success", "workers")
SETTINGS = ("success", "image_size", "replan_every", "render_profile", "workers", "timing")
"""Keys of a suite that the command line can give too; it replaces those of `REPLACING`, the others must not differ."""


class SelectionError(Exception):
    """The selection matches nothing in the suite."""


@dataclass(frozen=True)
class SuiteSelection:
    """The selected part of a suite; everything by default."""

    policies: tuple[str, ...] = ()
    """Names, or patterns such as `ties-*`."""
    tasks: tuple[str, ...] = ()
    """`simulator/task`, or patterns."""
    seeds: int | None = None
    """Number of seeds, from the first."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of those policies that the suite lacks."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Keys of `SETTINGS` to their values."""
    added: tuple[PolicyEntry, ...] = ()
    """Policies that the suite lacks, beside those that `policies` names."""

    def set_in(self, suite: Suite) -> Suite:
        """Return the suite with the settings, of which those of `REPLACING` may replace what it states.

        Raises:
            SelectionError: The suite states another value.
        """
        for name, value in self.settings.items():
            own = getattr(suite, name)
            if name in suite.model_fields_set and own != value and name not in REPLACING:
                raise SelectionError(
                    f"{option_of(name)} {value}: expected no other value than that of the suite, which states "
                    f"{name}: {own}; leave the option out, or change the suite"
                )
        return suite.model_copy(update=dict(self.settings)) if self.settings else suite

    def apply_to(self, suite: Suite) -> Suite:
        """Return the selected part of a suite with expanded task patterns; comparisons need all their policies.

        Raises:
            SelectionError: A name or pattern without a match, or more seeds than the suite has.
        """
        names = match_patterns("policy", self.policies, [policy.name for policy in suite.policies])
        count = suite.seeds.count if self.seeds is None else self.seeds
        if not 1 <= count <= suite.seeds.count:
            raise SelectionError(f"expected 1 to {suite.seeds.count} seeds, got {count}")
        tasks = match_patterns("task", self.tasks, suite.tasks)
        merging = suite.merging if _within(suite.merging, names) else None
        compare = suite.compare if _within(suite.compare, names) else None
        return suite.model_copy(
            update={
                "policies": tuple(policy for policy in suite.policies if policy.name in names),
                "tasks": tuple(task for task in suite.tasks if task in tasks),
                "seeds": Seeds(start=suite.seeds.start, count=count),
                "merging": merging,
                "compare": compare,
                "adaptive": suite.adaptive if merging or compare else None,
                "oracle_gate": suite.oracle_gate if suite.oracle_gate in names else None,
                "no_skill_baselines": tuple(name for name in suite.no_skill_baselines if name in names),
            }
        )


def option_of(setting: str) -> str:
    """Return the option of a setting on the command line."""
    return "--latency" if setting == "timing" else f"--{setting.replace('_', '-')}"


def _within(sides: MergingEntry | CompareEntry | None, names: set[str]) -> bool:
    return sides is not None and {name for _, name in sides.places()} <= names


def match_patterns(what: str, patterns: Iterable[str], names: Sequence[str], *, whole: str = "suite") -> set[str]:
    """Return the names that match any of the patterns (see `fnmatch`); all names without patterns.

    `what` and `whole` name their kind and origin in messages.

    Raises:
        SelectionError: A pattern without a match.
    """
    kept: set[str] = set()
    for pattern in patterns:
        matches = {name for name in names if fnmatchcase(name, pattern)}
        if not matches:
            raise SelectionError(f"the {whole} has no {what} '{pattern}'{did_you_mean(pattern, names)}")
        kept |= matches
    return kept or set(names)
