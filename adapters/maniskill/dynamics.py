"""Sets mass and friction of the objects of ManiSkill's tasks, and creates new physics scenes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from robogauntlet.adapters.maniskill.cameras import omit_reflections
from robogauntlet.adapters.scene_control import DynamicsFactors


@dataclass(frozen=True)
class _Own:
    """The original values of a body."""

    mass: float
    inertia: Any


class ManiSkillDynamics:
    """`BodyDynamics` of `scene_control`.

    A contact in PhysX takes the mean of two frictions: those of all bodies are scaled, so that the contact's is.
    """

    def __init__(self, env: Any, entities: Iterable[Any]) -> None:
        """Take an environment of ManiSkill and SAPIEN's entities of its movable objects."""
        import sapien

        self._bodies = [entity.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent) for entity in entities]
        self._own = [_Own(body.mass, body.inertia) for body in self._bodies]
        parts = [part for entity in env.scene.sub_scenes[0].entities for part in entity.components]
        shapes = [shape for part in parts for shape in getattr(part, "collision_shapes", ())]
        self._materials = [(shape, shape.physical_material) for shape in shapes]
        """Shapes share their materials, which are replaced and never changed."""
        self._shape = self._bodies[0].collision_shapes[0]
        self._friction = self._shape.physical_material.dynamic_friction
        self._changed = False

    def undo(self) -> None:
        """Restore mass and friction."""
        if self._changed:
            for body, own in zip(self._bodies, self._own, strict=True):
                body.mass, body.inertia = own.mass, own.inertia
            for shape, material in self._materials:
                shape.physical_material = material
            self._changed = False

    def dynamics(self) -> DynamicsFactors:
        """Return the present factors, which are equal for all objects, from PhysX."""
        friction = self._shape.physical_material.dynamic_friction
        return DynamicsFactors(self._bodies[0].mass / self._own[0].mass, friction / self._friction)

    def set_dynamics(self, dynamics: DynamicsFactors) -> None:
        """Scale mass and friction, until the next reset."""
        import sapien

        self._changed = True
        for body, own in zip(self._bodies, self._own, strict=True):
            body.mass, body.inertia = own.mass * dynamics.mass, own.inertia * dynamics.mass
        for shape, own in self._materials:
            static, sliding = dynamics.friction * own.static_friction, dynamics.friction * own.dynamic_friction
            shape.physical_material = sapien.physx.PhysxMaterial(static, sliding, own.restitution)


def renew_physics(env: Any) -> None:
    """Move everything into a new PhysX scene, without the contacts, warm starts and pair orders of the old one."""
    import sapien

    old = env.scene.sub_scenes[0]
    env._set_scene_config()
    physics = sapien.physx.PhysxCpuSystem()
    physics.timestep = env.scene.px.timestep
    new = sapien.Scene([physics, old.render_system])
    entities = list(old.entities)
    # Remove all before adding the first: an articulation's links cannot be in two scenes.
    for entity in entities:
        old.remove_entity(entity)
    for entity in entities:
        new.add_entity(entity)
    env.scene.sub_scenes[0], env.scene.px = new, physics
    omit_reflections(env)


def wake(entities: Iterable[Any]) -> None:
    """Wake entities with a dynamic body: reset the time for which PhysX has seen them at rest."""
    import sapien

    for entity in entities:
        entity.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent).wake_up()
