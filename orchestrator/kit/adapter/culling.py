"""Shapes that are left out of an image are those that it would not show."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import Image, Simulation
from robogauntlet.adapters.scene_control import Unreachable, Viewpoint
from robogauntlet.orchestrator.kit.adapter.check import NotApplicable, Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.orchestrator.kit.adapter.scene import three_props

SEED = 3
MOVES = 4
"""Moves of each camera."""
STEPS = 6
"""Random control steps between the moves."""
FOVY = (0.2, 2.0)
"""Fields of view of moved cameras (rad): narrow ones have more shapes across their edges."""


@check("culling", look="`culling`: which shapes are outside the view, by their present poses and sizes", renders=True)
def culling(subject: CheckedTask) -> Iterator[Violation]:
    """Leaving out shapes outside the view changes no pixel."""
    if not hasattr(subject.simulation, "culling"):
        raise NotApplicable("the simulation has no `culling`, so it draws all shapes")
    simulation: Any = subject.reset(SEED)
    own = simulation.culling
    try:
        for scene in _scenes(subject):
            simulation.culling = False
            whole = _images(simulation)
            simulation.culling = True
            for name, image in _images(simulation).items():
                other = int((image != whole[name]).any(axis=2).sum())
                yield from expect(
                    not other, f"{name} with culling to be that without, {scene}", f"{other} other pixels"
                )
    finally:
        simulation.culling = own


def _images(simulation: Simulation) -> dict[str, Image]:
    return {**simulation.observe().images, "the picture": simulation.picture()}


def _scenes(subject: CheckedTask) -> Iterator[str]:
    """Set up scenes one after the other, and yield a description of each: moved arm, cameras and props."""
    simulation, controls = subject.simulation, subject.scene_controls
    yield "at the start"
    random, actions = np.random.default_rng(SEED), subject.random_actions(SEED, STEPS * MOVES)
    if controls.table is not None:
        controls.table.show(three_props(subject, controls.table.table_height))
        yield "with props"
    if controls.arm is not None:
        state = simulation.privileged_state()
        with suppress(Unreachable):
            controls.arm.place_tool(state["tcp_position"] + [0.03, 0.05, 0.03], state["tcp_quaternion"])
        yield "with the arm elsewhere"
    cameras = controls.cameras
    own = {camera: cameras.viewpoint(camera) for camera in subject.view.cameras} if cameras is not None else {}
    for move in range(MOVES):
        for action in actions[STEPS * move : STEPS * (move + 1)]:
            simulation.step(action)
        for camera, viewpoint in own.items():
            position = viewpoint.position + random.uniform(-0.1, 0.1, 3)
            rotation = viewpoint.rotation @ Rotation.from_rotvec(random.uniform(-1.0, 1.0, 3)).as_matrix()
            assert cameras is not None
            cameras.set_viewpoint(camera, Viewpoint(position, rotation, random.uniform(*FOVY)))
        yield f"after {STEPS * (move + 1)} steps" + (" with moved cameras" if own else "")


CHECKS = (culling,)
