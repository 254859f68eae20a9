"""PhysX without a memory: what an episode starts from."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def renew_physics(env: Any) -> None:
    """Move everything into a new PhysX scene, which has no contacts, warm starts or pair orders to remember."""
    import sapien

    old = env.scene.sub_scenes[0]
    env._set_scene_config()
    physics = sapien.physx.PhysxCpuSystem()
    physics.timestep = env.scene.px.timestep
    new = sapien.Scene([physics, old.render_system])
    entities = list(old.entities)
    # All out before the first goes in: an articulation's links cannot be in two scenes.
    for entity in entities:
        old.remove_entity(entity)
    for entity in entities:
        new.add_entity(entity)
    env.scene.sub_scenes[0], env.scene.px = new, physics


def wake(things: Iterable[Any]) -> None:
    """Let PhysX count anew how long each thing (an entity with a dynamic body) has been at rest."""
    import sapien

    for thing in things:
        thing.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent).wake_up()
