"""CPU time of a frame with the shapes outside the view left out, and with all drawn, in turn in one process."""

import statistics
import time
from typing import Any

import numpy as np

from robogauntlet.adapters import catalog
from robogauntlet.adapters.mujoco_scene import import_mujoco
from robogauntlet.policies.oracles import scripts
from robogauntlet.suites.episode import RenderProfile, View
from tests.benchmarks.shared import TASKS, open_task, table_of

STATES, REPEATS, STEPS = 6, 5, 6
"""States, observations of each state and kind, and control steps of the oracle by which each state is later."""


def measure() -> list[dict[str, object]]:
    """Milliseconds per observation of one camera of 96 px, medians; shapes and triangles drawn where known."""
    rows: list[dict[str, object]] = []
    for task in TASKS:
        for camera in catalog.task_descriptions()[task].cameras:
            simulation: Any = open_task(task, View((camera,), render_profile=RenderProfile.FAST))
            kinds = (True, False) if hasattr(simulation, "culling") else (None,)
            spent: dict[bool | None, list[float]] = {kind: [] for kind in kinds}
            drawn: dict[bool | None, list[tuple[int, int]]] = {kind: [] for kind in kinds}
            equal = True
            for seed in range(STATES):
                simulation.reset(seed)
                script = scripts()[task]()
                for _ in range(STEPS * seed):
                    simulation.step(script(simulation.privileged_state()))
                for repeat in range(REPEATS + 1):
                    images = []
                    for kind in kinds:
                        if kind is not None:
                            simulation.culling = kind
                        start = time.process_time()
                        images.append(simulation.observe().images[camera])
                        spent[kind] += [1000 * (time.process_time() - start)] if repeat else []
                        drawn[kind] += drawn_by_mujoco(simulation)
                    equal &= all(np.array_equal(image, images[0]) for image in images)
            simulation.close()
            rows.append({"task": task, "camera": camera, **figures(spent, drawn), "equal": equal})
    columns = {"task": "{task}", "camera": "{camera}", "culled, ms": "{culled_ms:.1f}", "all drawn, ms": "{all_ms:.1f}"}
    columns |= {"ratio": "{ratio:.2f}", "shapes": "{shapes}", "triangles": "{triangles}", "pixels equal": "{equal}"}
    table_of(rows, columns)
    return rows


def figures(spent: Any, drawn: Any) -> dict[str, object]:
    """Medians of times, and means of what is drawn with culling of what is drawn without."""
    culled, whole = (statistics.median(spent[kind]) for kind in (next(iter(spent)), list(spent)[-1]))
    counts = [np.mean(seen, axis=0).astype(int) for seen in drawn.values() if seen]
    shapes, triangles = (" of ".join(str(count[i]) for count in counts) or "?" for i in (0, 1))
    return {"culled_ms": culled, "all_ms": whole, "ratio": whole / culled, "shapes": shapes, "triangles": triangles}


def drawn_by_mujoco(simulation: Any) -> list[tuple[int, int]]:
    """Return shapes, and triangles of meshes, in the last frame; nothing in other simulators."""
    if not hasattr(simulation, "_scene"):
        return []
    (renderer,) = (one for size, one in simulation._scene.renderers.items() if size == simulation.view.image_size)
    shapes = renderer.scene.geoms[: renderer.scene.ngeom]
    meshes = [shape.dataid // 2 for shape in shapes if shape.type == import_mujoco().mjtGeom.mjGEOM_MESH]
    return [(len(shapes), int(renderer.model.mesh_facenum[meshes].sum()))]
