"""Accuracy of routers on first observations with sentences, light and cameras that no choice has looked at.

No episode is played. A row has its decisions, as the experts' numbers in the order of their names, in the order of
tasks, seeds and sentences. `python -m studies routing --measure shifted_routing`
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from robogauntlet.orchestrator.replay.first_observation import first_observation
from robogauntlet.orchestrator.replay.media_selection import Snapshot
from robogauntlet.results.statistics.rates import clustered_rate
from robogauntlet.suites.episode import Condition, Perturbation as At
from studies.percent import few
from studies.routing.routers import by_router, interval
from studies.shared import EXPERT_VIEW, open_task, table_of

if TYPE_CHECKING:
    from robogauntlet.adapters.contract import Observation
    from robogauntlet_mergevla.routing.contract import FirstObservation

SEEDS = range(few(20))
SENTENCES = {
    "maniskill/PullCube-v1": (
        "could the blue cube be on the target, nearer to you",
        "blue cube back to the rings",
        "i want to see the blue cube in the bullseye, so draw it closer",
        "move the cube towards the robot until it covers the target",
    ),
    "maniskill/PushCube-v1": (
        "could the blue cube be on the target, further away",
        "blue cube forward to the rings",
        "i want to see the blue cube in the bullseye, so nudge it along",
        "move the cube away from the robot until it covers the target",
    ),
    "maniskill/StackCube-v1": (
        "could the red cube sit on the green one",
        "red cube onto green cube",
        "make a tower of two with green at the bottom",
        "grab the red cube, raise it and release it above the green cube",
    ),
    "pybullet/PandaPickAndPlace-v3": (
        "could the green cube be lifted to the red place",
        "grip green cube then to red",
        "hold the green cube and take it through the air to the red area",
        "take hold of the cube and bring it where the goal is",
    ),
    "pybullet/PandaPush-v3": (
        "could the green cube slide to the red place",
        "green cube along the table to red",
        "get the green cube over to the red area without lifting it",
        "keep the cube on the table and move it to the goal",
    ),
    "pybullet/PandaReach-v3": (
        "could the hand go to the red ball",
        "hand to the ball",
        "move your fingertips until they meet the ball",
        "bring the end of the arm to where the red ball floats",
    ),
    "robosuite/Door": (
        "could the door be open",
        "door open",
        "use the handle to open the door",
        "get this door open by its lever",
    ),
    "robosuite/Lift": (
        "could the red cube go up",
        "red cube up",
        "get hold of the red cube and raise it above the table",
        "take the cube in the gripper and bring it higher",
    ),
    "robosuite/Stack": (
        "could the red cube rest on the green one",
        "red onto green",
        "set the red cube down on top of the green one",
        "two cubes make a tower with the green one below",
    ),
}
"""A question, a few words and two other wordings for each task, written before any router was asked about them."""
LIGHT = (At("illuminance", 3), At("colour-temperature", 3), At("light-direction", 3))
CAMERA = (At("camera-orbit", 3), At("camera-distance", 3), At("field-of-view", 3))
SHIFTS = {
    "as trained": (Condition(), False),
    "sentences": (Condition(), True),
    "light": (Condition.of(*LIGHT), False),
    "camera": (Condition.of(*CAMERA), False),
    "all three": (Condition.of(*LIGHT, *CAMERA), True),
}
"""Shift to its condition, and whether the task's `SENTENCES` take the place of its instruction."""
ROUTERS = ("calibrated", "self-trained", "nearest-centroid", "instruction-match", "paper-coded")
"""Those of `zoo:merged`; word matching is of no use where the instruction is hidden."""


def measure() -> list[dict[str, object]]:
    """A row for each router, with the instruction read and hidden: its accuracy under each shift."""
    import torch

    from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
    from robogauntlet_mergevla.checkpoints.merged_model import MergedModel

    torch.set_num_threads(1)
    checkpoint = load_merged("zoo:merged")
    model = MergedModel(checkpoint.parts)
    seen = observed(model.experts)
    rows: list[dict[str, object]] = []
    for sees, instruction in ((True, "read"), (False, "hidden")):
        for name in ROUTERS if sees else (name for name in ROUTERS if name != "instruction-match"):
            scores = by_router(name, model, checkpoint.fitted)
            chosen = {shift: _text(scores(own, sees).argmax(dim=1).tolist()) for shift, own in seen.items()}
            rows.append({"router": name, "instruction": instruction, "decisions": chosen})
    rows = [row | rates(row["decisions"], model.experts) for row in rows]  # type: ignore[arg-type]
    shifts = {shift: f"{{{shift}}}" for shift in SHIFTS}
    table_of(rows, {"router": "{router}", "instruction": "{instruction}", **shifts})
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, their rates from the kept decisions."""
    return [dict(row) | rates(row["decisions"], sorted(SENTENCES)) for row in rows]


def rates(decisions: Mapping[str, str], experts: Sequence[str]) -> dict[str, str]:
    """Shift to the share of decisions that name the task's expert, with its 95 % interval.

    Where several sentences share an image, the interval is clustered by image and by sentence.
    """
    found = {}
    for shift, chosen in decisions.items():
        each = len(chosen) // len(experts)
        right = [int(choice) == place // each for place, choice in enumerate(chosen)]
        sentences = each // len(SEEDS)
        if sentences == 1:
            found[shift] = interval(right)
            continue
        trials = np.arange(len(chosen))
        texts = trials // each * sentences + trials % sentences
        share = clustered_rate(np.array(right, float), texts, trials // sentences)
        assert share.interval is not None
        found[shift] = f"{100 * share.value:.1f} % [{100 * share.interval.low:.0f}, {100 * share.interval.high:.0f}]"
    return found


def observed(tasks: Sequence[str]) -> dict[str, list[FirstObservation]]:
    """First observations of all tasks, in their order, under each shift."""
    found: dict[str, list[FirstObservation]] = {shift: [] for shift in SHIFTS}
    for task in tasks:
        simulation = open_task(task, EXPERT_VIEW)
        for shift, (condition, rewords) in SHIFTS.items():
            for seed in SEEDS:
                snapshot = Snapshot(task, condition, seed, EXPERT_VIEW)
                found[shift] += _worded(snapshot, first_observation(simulation, snapshot), rewords=rewords)
        simulation.close()
        print(f"{task}: observed", flush=True)
    return found


def _worded(snapshot: Snapshot, observation: Observation, *, rewords: bool) -> Iterator[FirstObservation]:
    from robogauntlet_mergevla.routing.observation_cache import ObservationCache

    cache = ObservationCache.of(snapshot.task, snapshot.view, [snapshot.seed], [observation])
    (first,) = cache.observations([snapshot.seed])
    for sentence in SENTENCES[snapshot.task] if rewords else (first.instruction,):
        yield replace(first, instruction=sentence)


def _text(chosen: Sequence[int]) -> str:
    return "".join(map(str, chosen))
