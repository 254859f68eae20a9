"""A part of a suite: some of its policies, tasks or seeds. Its episodes are the whole suite's, with the same ids."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from suites.plugins import nearest
from suites.schema import CompareEntry, MergingEntry, Seeds, Suite


class NoSuchPart(Exception):
    """The suite has nothing that was asked for."""


@dataclass(frozen=True)
class Part:
    """What to keep of a suite; everything by default."""

    policies: tuple[str, ...] = ()
    """Names, or patterns such as `ties-*`."""
    tasks: tuple[str, ...] = ()
    """`simulator/task`, or patterns."""
    seeds: int | None = None
    """The first so many."""

    def of(self, suite: Suite) -> Suite:
        """The suite with nothing else in it. A comparison of which a policy is left out is left out too.

        Args:
            suite: With its task patterns replaced, see `Suite.with_names`.

        Raises:
            NoSuchPart: A name or pattern that finds nothing, or more seeds than the suite has.
        """
        names = kept("policy", self.policies, [policy.name for policy in suite.policies])
        count = suite.seeds.count if self.seeds is None else self.seeds
        if not 1 <= count <= suite.seeds.count:
            raise NoSuchPart(f"expected 1 to {suite.seeds.count} seeds, got {count}")
        merging = suite.merging if _within(suite.merging, names) else None
        compare = suite.compare if _within(suite.compare, names) else None
        return suite.model_copy(
            update={
                "policies": tuple(policy for policy in suite.policies if policy.name in names),
                "tasks": tuple(task for task in suite.tasks if task in kept("task", self.tasks, suite.tasks)),
                "seeds": Seeds(start=suite.seeds.start, count=count),
                "merging": merging,
                "compare": compare,
                "adaptive": suite.adaptive if merging or compare else None,
                "gate": suite.gate if suite.gate in names else None,
                "floors": tuple(name for name in suite.floors if name in names),
            }
        )


def _within(sides: MergingEntry | CompareEntry | None, names: set[str]) -> bool:
    return sides is not None and {name for _, name in sides.places()} <= names


def kept(what: str, patterns: Iterable[str], names: Sequence[str], *, whole: str = "suite") -> set[str]:
    """The names that some pattern finds; all of them if there is no pattern.

    Args:
        what: Kind of the names, for messages.
        patterns: Names, or patterns as `fnmatch` has them.
        names: All there are.
        whole: Of what they are, for messages.

    Raises:
        NoSuchPart: A pattern finds nothing.
    """
    kept: set[str] = set()
    for pattern in patterns:
        found = {name for name in names if fnmatchcase(name, pattern)}
        if not found:
            raise NoSuchPart(f"the {whole} has no {what} '{pattern}'{nearest(pattern, names)}")
        kept |= found
    return kept or set(names)
