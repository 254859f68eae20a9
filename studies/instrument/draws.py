"""The played builds, and comparisons of them on seeds that are drawn, by the product's own calls."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

import robogauntlet
from robogauntlet import OpenRun
from robogauntlet.results.record import BEHAVIOUR
from robogauntlet.results.run_document import RUN_FILE, RunStatus
from robogauntlet.results.statistics.multiplicity import ALPHA
from studies.percent import few, folder_of
from studies.shared import run_suite

REFERENCE, POLICY = "reference", "policy"
"""The build of the shipped policy, and what every build is called in its run."""
SUITE = Path(__file__).with_name("instrument.yaml")
SEEDS = tuple(few(count, 1) for count in (10, 20, 40))
"""Seeds of each task in a drawn comparison."""
DRAWS = few(200)
EPISODE = ("build", "task", "seed", "status")


def folder() -> Path:
    """Where builds are played: `INSTRUMENT`, by default `runs/instrument`."""
    return folder_of("INSTRUMENT", "instrument")


def builds() -> dict[str, OpenRun]:
    """The runs of all builds, in the order of the suite; what they lack is played first.

    `robogauntlet resume` continues one of them, and so does calling this again.
    """
    plan = yaml.safe_load(SUITE.read_text(encoding="utf-8"))
    return {entry["name"]: _played(plan, entry) for entry in policies()}


def policies() -> list[dict[str, Any]]:
    """The policies of the suite; weights with noise are made in the folder, unless they are there."""
    found: list[dict[str, Any]] = yaml.safe_load(SUITE.read_text(encoding="utf-8"))["policies"]
    for entry in found:
        name = Path(entry["options"].get("folder", "")).name
        if name.startswith("noise-"):
            checkpoint = folder() / name
            entry["options"]["folder"] = str(checkpoint)
            if not checkpoint.exists():
                command = [sys.executable, "-m", "studies.instrument.weights", str(int(name[-2:]) / 100)]
                subprocess.run([*command, str(checkpoint)], check=True)
    return found


def _played(plan: dict[str, Any], entry: dict[str, Any]) -> OpenRun:
    """A build in a run of its own."""
    suite, run = folder() / f"suites/{entry['name']}.yaml", folder() / f"played/{entry['name']}"
    if (run / RUN_FILE).exists() and robogauntlet.open_run(run).document.status is RunStatus.COMPLETE:
        return robogauntlet.open_run(run)
    suite.parent.mkdir(parents=True, exist_ok=True)
    suite.write_text(
        yaml.safe_dump({**plan, "policies": [{**entry, "name": POLICY}]}, sort_keys=False), encoding="utf-8"
    )
    run_suite(suite, run)
    return robogauntlet.open_run(run)


def episodes_of_builds(played: dict[str, OpenRun]) -> pd.DataFrame:
    """A row per episode, columns `EPISODE`."""
    frames = [run.episodes(EPISODE[1:]).assign(build=name) for name, run in played.items()]
    return pd.concat(frames, ignore_index=True)[list(EPISODE)]


@dataclass(frozen=True, slots=True)
class Answers:
    """What two verbs say of one drawn comparison."""

    compare: bool
    """Whether `compare` finds a difference over all tasks."""
    gate: bool
    """Whether `compare --gate` finds a regression."""


class Drawn(OpenRun):
    """A run of which some episodes are read, without what is measured of the motion."""

    def __init__(self, run: OpenRun, name: str, rows: pd.DataFrame) -> None:
        super().__init__(run.folder.parent / name, run.document, None)
        self._rows = rows

    def episodes(self, fields: Any = None) -> pd.DataFrame:
        """The drawn rows."""
        return self._rows if fields is None else self._rows[list(fields)]


def rows_of_run(run: OpenRun) -> pd.DataFrame:
    """All fields of a run's episodes in the order of tasks and seeds, without the motion, which is not asked about."""
    return run.episodes().assign(**dict.fromkeys(BEHAVIOUR)).sort_values(["task", "seed"], ignore_index=True)


_SAID: dict[frozenset[Any], Answers] = {}
"""Answers by what they depend on: how many pairs of each task have which outcomes."""


def answers(run: OpenRun, baseline: OpenRun, rows: pd.DataFrame, before: pd.DataFrame) -> Answers:
    """Compare rows of a run with those of a baseline, in the same order, by `compare` with and without `--gate`."""
    key = frozenset(Counter(zip(rows["task"], rows["status"], before["status"], strict=True)).items())
    if key not in _SAID:
        new, old = Drawn(run, "new", rows), Drawn(baseline, "old", before)
        (found,) = new.compare(POLICY, POLICY, other=old).comparisons
        is_worse = robogauntlet.compare(new, old).verdict == "regressed"
        _SAID[key] = Answers(found.overall.adjusted <= ALPHA, is_worse)
    return _SAID[key]


def drawn_rows(rows: pd.DataFrame, count: int) -> Iterator[NDArray[np.intp]]:
    """Which rows, in the order of tasks and seeds, are of the seeds of each draw, the same seeds at every call.

    Seeds are drawn with replacement, so that the true rates of what is drawn from are those of all rows.
    """
    generator, places = np.random.default_rng(count), np.arange(len(rows)).reshape(rows["task"].nunique(), -1)
    for _ in range(DRAWS):
        yield places[:, generator.integers(places.shape[1], size=count)].ravel()


def renamed(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with their places as identities, since a seed can be drawn twice."""
    return rows.assign(pair_id=np.arange(len(rows)).astype(str))
