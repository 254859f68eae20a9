"""Designs: sets of combinations of perturbation axes that a suite asks for by name instead of listing them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainSerializer, model_validator

from robogauntlet.suites.axes import AXES, SEVERITIES, why_exclusive
from robogauntlet.suites.conditions import in_hundredths
from robogauntlet.suites.episode import AND, AT, Condition, Perturbation
from robogauntlet.suites.ranges import MAX_ENTRIES, Text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


Severity = Annotated[float, Field(strict=True), AfterValidator(in_hundredths), PlainSerializer(lambda value: value)]
"""A severity; whole ones are integers, so that they are written alike."""
DEFAULT_SEVERITIES = tuple(range(1, SEVERITIES + 1))
LISTED = ("one-at-a-time", "grid")
"""Designs of given severities; the others spread points over all severities."""


class DesignEntry(BaseModel):
    """Combinations of axes to play besides the conditions that a suite lists."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["one-at-a-time", "grid", "latin-hypercube", "sobol"]
    """`one-at-a-time`: each axis at each severity. `grid`: every combination of severities, absence included.
    `latin-hypercube`: points that fill all axes evenly. `sobol`: pick-freeze points for sensitivity indices."""
    axes: tuple[Text, ...] = Field(min_length=1, max_length=len(AXES))
    severities: tuple[Annotated[Severity, Field(gt=0, le=SEVERITIES)], ...] | None = Field(default=None, min_length=1)
    """Severities of each axis, by default 1 to 5; for `one-at-a-time` and `grid`."""
    max_severity: Annotated[Severity, Field(gt=0, le=SEVERITIES)] | None = None
    """Upper end of the range from 0 in which points lie, by default 5; for `latin-hypercube` and `sobol`."""
    points: Annotated[int, Field(strict=True, ge=1, le=MAX_ENTRIES)] | None = None
    """Points of `latin-hypercube`; base points of `sobol`, each of which takes two conditions and one per axis."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] | None = None
    """Draws the points, by default 0. With the same seed, twice as many points contain the first half."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        repeated = [axis for i, axis in enumerate(self.axes) if axis in self.axes[:i]]
        if repeated:
            raise ValueError(f"expected each axis once, got '{repeated[0]}' twice")
        listed = self.severities or ()
        if twice := [severity for i, severity in enumerate(listed) if severity in listed[:i]]:
            raise ValueError(f"expected each severity once, got {twice[0]:g} twice")
        wrong = ("max_severity", "points", "seed") if self.kind in LISTED else ("severities",)
        if meaningless := [name for name in wrong if getattr(self, name) is not None]:
            raise ValueError(
                f"expected no '{meaningless[0]}' for kind {self.kind}, got {getattr(self, meaningless[0])}"
            )
        if self.kind not in LISTED and self.points is None:
            raise ValueError(f"expected points of a {self.kind} design, such as points: 64, got none")
        if self.kind == "sobol" and self.points and self.points & (self.points - 1):
            raise ValueError(f"expected a power of two as points of a sobol design, got {self.points}")
        if self.conditions_planned > MAX_ENTRIES:
            most = f"expected {MAX_ENTRIES} conditions at most"
            raise ValueError(f"{most}, got a design of {self.conditions_planned}; ask for fewer points or axes")
        for axis in self.axes:
            if set(axis) & {AT, AND}:
                raise ValueError(f"expected the name of an axis, got '{axis}'")
            if (self.max_severity or SEVERITIES) < 1 and axis in AXES and AXES[axis].unchanged is None:
                raise ValueError(f"expected max_severity from 1 for '{axis}', which has whole severities, got less")
        if self.kind != "one-at-a-time" and (reason := why_exclusive(self.axes)):
            raise ValueError(reason)
        return self

    @property
    def conditions_planned(self) -> int:
        """Rows of the design."""
        axes, severities, points = len(self.axes), len(self.severities or DEFAULT_SEVERITIES), self.points or 0
        rows = {"one-at-a-time": axes * severities, "grid": (severities + 1) ** axes, "sobol": points * (axes + 2)}
        return rows.get(self.kind, points)

    def conditions(self) -> tuple[Condition, ...]:
        """One condition per row of the design, which may repeat; `sobol_rows` explains the order for `sobol`."""
        return _conditions(self)


@cache
def _conditions(design: DesignEntry) -> tuple[Condition, ...]:
    axes, severities = design.axes, design.severities or DEFAULT_SEVERITIES
    if design.kind == "one-at-a-time":
        return tuple(Condition.of(Perturbation(axis, severity)) for axis in axes for severity in severities)
    if design.kind == "grid":
        return tuple(_combined(axes, row) for row in product((0, *severities), repeat=len(axes)))
    draw = latin_hypercube if design.kind == "latin-hypercube" else sobol_rows
    points, highest = draw(len(axes), design.points or 0, design.seed or 0), design.max_severity or SEVERITIES
    return tuple(_combined(axes, _severities(axes, row, highest)) for row in points.tolist())


def _combined(axes: Sequence[str], severities: Sequence[float]) -> Condition:
    return Condition.of(*map(Perturbation, axes, severities))


def _severities(axes: Sequence[str], row: Sequence[float], highest: float) -> list[float]:
    """Severities of a point in [0, 1)^d; each whole severity of an axis that has no others is equally likely."""
    whole = [axis in AXES and AXES[axis].unchanged is None for axis in axes]
    return [int(x * (int(highest) + 1)) if is_whole else x * highest for x, is_whole in zip(row, whole, strict=True)]


def latin_hypercube(axes: int, points: int, seed: int) -> NDArray[np.float64]:
    """Return points of shape (points, axes) in [0, 1) with one point in each of `points` equal intervals of each axis.

    The first half of an even number of points is the design of half as many: an interval with a point is halved, and
    the empty halves are filled in random order (inherited Latin hypercubes, Wang 2003, J. Mech. Design 125, 210).
    """
    import numpy as np
    from scipy.stats.qmc import LatinHypercube

    odd = points
    while odd % 2 == 0:
        odd //= 2
    found: NDArray[np.float64] = LatinHypercube(axes, rng=np.random.default_rng([seed, odd])).random(odd)
    while len(found) < points:
        n = 2 * len(found)
        generator = np.random.default_rng([seed, n])
        taken = np.floor(found * n).astype(int)
        empty = [generator.permutation(np.setdiff1d(np.arange(n), taken[:, axis])) for axis in range(axes)]
        new = (np.stack(empty, axis=1) + generator.random((len(found), axes))) / n
        found = np.concatenate([found, new])
    return found


def sobol_rows(axes: int, points: int, seed: int | np.random.Generator) -> NDArray[np.float64]:
    """Return the rows (points x (axes + 2), axes) in [0, 1) of a pick-freeze design (Saltelli et al. 2010).

    For each base point: A; then A with the value of B on the first axis, the second and so on; then B. A and B are the
    halves of a scrambled Sobol' point of twice as many dimensions, so that the rows of more points begin with these.
    """
    import numpy as np
    from scipy.stats.qmc import Sobol

    drawn = Sobol(2 * axes, scramble=True, rng=np.random.default_rng(seed)).random(points)
    first, second = drawn[:, :axes], drawn[:, axes:]
    rows = np.repeat(first[:, None], axes + 2, axis=1)
    for axis in range(axes):
        rows[:, axis + 1, axis] = second[:, axis]
    rows[:, -1] = second
    return rows.reshape(-1, axes)
