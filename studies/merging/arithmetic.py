"""Weighted sums of whole networks (arXiv 2602.09021): of trainings on parts of one task's data, and of nine tasks.

`ARITHMETIC=FOLDER DEMONSTRATIONS=FOLDER python -m studies merging --measure arithmetic` trains (by default in
`runs/arithmetic`; 150 demonstrations of each of the nine tasks, as `training_controls.sh` records them), adds and
plays. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd

from robogauntlet.policies.training.dataset import open_datasets
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.finetune import finetune
from robogauntlet_mergevla.training.settings import Settings
from robogauntlet_mergevla.zoo import shipped
from studies.merging.network_sums import BASE, Whole, added, save, shares_of
from studies.merging.operators import percent
from studies.percent import few, folder_of
from studies.shared import play_policies, table_of
from studies.tables import write_episodes

TASKS = {"robosuite/Stack": "Stack", "pybullet/PandaPush-v3": "PandaPush"}
"""Tasks that the base solves in part."""
PARTS, STEPS = few(4), few(600)
FIRST, SEEDS, NINE_SEEDS = 30_000, 50, 20
SUMS = {
    "average": "average",
    "inverse-loss": "by inverse loss",
    "learned": "learned by gradient descent",
    "greedy": "greedy",
}
TITLES = {
    "base": "the base",
    "part": "one part (mean of four)",
    **{way: f"sum of four, {title}" for way, title in SUMS.items()},
    "whole": "all data, as many steps as a part",
    "longer": "all data, four times the steps",
}
NINE = {"nine-base": "the base", **{f"nine-{way}": f"sum of nine experts, {title}" for way, title in SUMS.items()}}
EPISODE = ("policy", "task", "seed", "status")
COLUMNS = {"network": "{title}", **{title: f"{{{title}}}" for title in (*TASKS.values(), "nine tasks")}}


class Part(DatasetMixture):
    """A part of the training episodes of one dataset, normalised by the statistics of all of them."""

    def __init__(self, datasets: Sequence, part: int | None) -> None:
        """Take every fourth training episode from `part` on, or all."""
        super().__init__(datasets)
        self.statistics  # noqa: B018  computed, and kept, before episodes are left out
        if part is not None:
            ((dataset,), (frames,)) = self.datasets, self._train
            episode = np.repeat(np.arange(dataset.episodes), dataset.ends - dataset.starts)[frames]
            _, number = np.unique(episode, return_inverse=True)
            self._train = [frames[number % PARTS == part]]


def train(data: Path, out: Path, part: int | None, steps: int) -> None:
    """Fine-tune the zoo's base on a part of a task's data, or go on with it."""
    if (out / METADATA_FILE).exists():
        return
    mixture = Part(open_datasets([data]), part)
    mixture.datasets[0].preload()
    settings = Settings(steps=steps, learning_rate=1e-3, largest_shift=2, seed=part or 0)
    finetune(mixture, shipped(BASE), out, settings, lora=LoraSettings(), action_steps=4)
    print(f"{out.name} of {out.parent.name}: trained", flush=True)


def trainings(folder: Path, data: Path) -> Iterator[partial[None]]:
    """All trainings, the long ones first."""
    names = {task: task.replace("/", "__") for task in TASKS}
    for name in names.values():
        yield partial(train, data / name, folder / "trained" / name / "longer", None, PARTS * STEPS)
    for name in names.values():
        yield partial(train, data / name, folder / "trained" / name / "whole", None, STEPS)
        for part in range(PARTS):
            yield partial(train, data / name, folder / "trained" / name / f"part-{part}", part, STEPS)


def measure() -> list[dict[str, object]]:
    """A row for each network; writes the episodes beside the rows."""
    folder = folder_of("ARITHMETIC", "arithmetic")
    data = Path(os.environ.get("DEMONSTRATIONS", folder / "demonstrations")).absolute()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(one) for one in trainings(folder, data)]:
            done.result()
    policies = {"base": {"kind": "mergevla", "options": {"checkpoint": BASE}}}
    for task in TASKS:
        name = task.replace("/", "__")
        parts = [Whole.read(folder / "trained" / name / f"part-{part}") for part in range(PARTS)]
        mixture = DatasetMixture.open([data / name])
        for way in SUMS:
            write_sum(folder / "sums" / way, way, parts, mixture, [parts[0]])
        for number, network in enumerate(parts):
            write_as(folder / "sums" / f"part-{number}" / name, network)
        for kind in ("whole", "longer"):
            write_as(folder / "sums" / kind / name, Whole.read(folder / "trained" / name / kind))
    for path in sorted((folder / "sums").iterdir()):
        policies[path.name] = {"kind": "mergevla-experts", "options": {"folder": str(path)}}
    frames = [play_policies(folder, "parts", policies, [*TASKS], SEEDS, EPISODE, first=FIRST)]
    experts = {task: Whole.read(path) for task, path in expert_folders(shipped("zoo:experts")).items()}
    mixture = DatasetMixture.open([data / task.replace("/", "__") for task in experts])
    nine = {"nine-base": policies["base"]}
    for way in SUMS:
        write_sum(folder / "nine" / way, way, [*experts.values()], mixture, [*experts.values()])
        nine[f"nine-{way}"] = {"kind": "mergevla-experts", "options": {"folder": str(folder / "nine" / way)}}
    frames.append(play_policies(folder, "nine", nine, [*experts], NINE_SEEDS, EPISODE, first=FIRST))
    frame = pd.concat(frames)
    write_episodes("arithmetic", frame, EPISODE[:3])
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def write_sum(
    folder: Path, way: str, networks: Sequence[Whole], mixture: DatasetMixture, tasks: Sequence[Whole]
) -> None:
    """Write the sum of networks, once for each task that it is to act in."""
    paths = {of: folder / of.metadata.tasks[0].replace("/", "__") for of in tasks}
    if all((path / METADATA_FILE).exists() for path in paths.values()):
        return
    statistics = TaskStatistics({of.metadata.tasks[0]: of.metadata.statistics.of(of.metadata.tasks[0]) for of in tasks})
    shares = shares_of(way, networks, statistics, mixture)
    print(f"{way} of {folder.parent.name}: {', '.join(f'{share:.2f}' for share in shares)}", flush=True)
    weights = added([network.weights for network in networks], shares)
    for of, path in paths.items():
        save(path, weights, of.metadata, of.metadata.statistics)


def write_as(folder: Path, network: Whole) -> None:
    """Write a network as it is."""
    save(folder, network.weights, network.metadata, network.metadata.statistics)


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success with Wilson's interval by task, and in all nine. `frame` has a row per episode."""
    won = frame.assign(
        won=frame.status == "success", network=frame.policy.str.replace(r"^part-\d$", "part", regex=True)
    )
    rows: list[dict[str, object]] = []
    for network, title in (TITLES | NINE).items():
        own = won[won.network == network]
        if network in NINE:
            cells = {"nine tasks": _rate(own.won), **dict.fromkeys(TASKS.values(), "")}
        else:
            cells = {name: _rate(own[own.task == task].won) for task, name in TASKS.items()} | {"nine tasks": ""}
        rows.append({"way": network, "title": title, **cells})
    return rows


def _rate(won: pd.Series) -> str:
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won)))
