"""CPU time of a frame of both `fast` profiles, and of `fast` with all shapes drawn, in turn in one process."""

import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from robogauntlet.adapters import catalog
from robogauntlet.adapters.mujoco_scene import import_mujoco
from robogauntlet.policies.oracles import scripts
from robogauntlet.suites.episode import RenderProfile, View
from studies.percent import few
from studies.shared import TASKS, open_task, table_of

STATES, REPEATS, STEPS = 6, 5, 6
"""States, observations of each state and kind, and control steps of the oracle by which each state is later."""
WHOLE, CULLED, SIMPLIFIED = "whole", "culled", "simplified"
"""Kinds of frames: `fast` with all shapes drawn, `fast`, and `fast-2`."""


def measure(tasks: Sequence[str] = TASKS) -> list[dict[str, object]]:
    """Milliseconds per observation of one camera of 96 px, medians; shapes and triangles drawn where known."""
    rows: list[dict[str, object]] = []
    for task in tasks:
        for camera in catalog.task_descriptions()[task].cameras:
            profiles = {WHOLE: RenderProfile.FAST, CULLED: RenderProfile.FAST, SIMPLIFIED: RenderProfile.FAST_2}
            opened: dict[str, Any] = {
                profile: open_task(task, View((camera,), render_profile=profile)) for profile in set(profiles.values())
            }
            spent: dict[str, list[float]] = {kind: [] for kind in profiles}
            drawn: dict[str, list[tuple[int, int]]] = {kind: [] for kind in profiles}
            equal = True
            for seed in range(few(STATES)):
                for simulation in opened.values():
                    simulation.reset(seed)
                    script = scripts()[task]()
                    for _ in range(STEPS * seed):
                        simulation.step(script(simulation.privileged_state()))
                for repeat in range(few(REPEATS) + 1):
                    images = {}
                    for kind, profile in profiles.items():
                        simulation = opened[profile]
                        simulation.culling = kind != WHOLE
                        start = time.process_time()
                        images[kind] = simulation.observe().images[camera]
                        spent[kind] += [1000 * (time.process_time() - start)] if repeat else []
                        drawn[kind] += drawn_by_mujoco(simulation)
                    equal &= np.array_equal(images[WHOLE], images[CULLED])
            for simulation in opened.values():
                simulation.close()
            rows.append({"task": task, "camera": camera, **figures(spent, drawn), "equal": equal})
    columns = {
        "task": "{task}",
        "camera": "{camera}",
        "`fast`, all drawn, ms": "{whole:.1f}",
        "`fast`, ms": "{culled:.1f}",
    }
    columns |= {"ratio": "{culled_ratio:.1f}", "pixels equal": "{equal}", "`fast-2`, ms": "{simplified:.1f}"}
    columns |= {"ratio to `fast`, all drawn": "{simplified_ratio:.1f}", "triangles": "{triangles}"}
    table_of(rows, columns)
    return rows


def figures(spent: dict[str, list[float]], drawn: dict[str, list[tuple[int, int]]]) -> dict[str, object]:
    """Medians of times, their ratios, and mean numbers of triangles, by kind."""
    times = {kind: statistics.median(values) for kind, values in spent.items()}
    ratios = {f"{kind}_ratio": times[WHOLE] / times[kind] for kind in (CULLED, SIMPLIFIED)}
    triangles = [f"{int(np.mean(seen, axis=0)[1]):,}" for seen in drawn.values() if seen]
    return {**times, **ratios, "triangles": ", ".join(triangles) or "-"}


def drawn_by_mujoco(simulation: Any) -> list[tuple[int, int]]:
    """Return shapes, and triangles of meshes, in the last frame; nothing in other simulators."""
    if not hasattr(simulation, "_scene"):
        return []
    (renderer,) = (one for size, one in simulation._scene.renderers.items() if size == simulation.view.image_size)
    shapes = renderer.scene.geoms[: renderer.scene.ngeom]
    meshes = [shape.dataid // 2 for shape in shapes if shape.type == import_mujoco().mjtGeom.mjGEOM_MESH]
    return [(len(shapes), int(renderer.model.mesh_facenum[meshes].sum()))]
