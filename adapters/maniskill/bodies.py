"""Sets mass and friction of the objects of ManiSkill's tasks, and renews their physics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from robogauntlet.adapters.scene_control import DynamicsFactors


@dataclass(frozen=True)
class _Own:
    """What a body has of its own, to the bit."""

    mass: float
    inertia: Any
    materials: tuple[Any, ...]
    """SAPIEN's, one for each collision shape. Other things share them, so they are exchanged and never changed."""


class ManiSkillBodies:
    """See `scene_control.BodyDynamics`. PhysX takes the mean of the two coefficients of friction of a contact."""

    def __init__(self, things: Iterable[Any]) -> None:
        """Args: things: SAPIEN's entities, those that can be moved."""
        import sapien

        self._bodies = [thing.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent) for thing in things]
        self._own = [
            _Own(body.mass, body.inertia, tuple(shape.physical_material for shape in body.collision_shapes))
            for body in self._bodies
        ]
        self._changed = False

    def undo(self) -> None:
        """Give every thing its own mass and friction back."""
        if self._changed:
            for body, own in zip(self._bodies, self._own, strict=True):
                body.mass, body.inertia = own.mass, own.inertia
                for shape, material in zip(body.collision_shapes, own.materials, strict=True):
                    shape.physical_material = material
            self._changed = False

    def dynamics(self) -> DynamicsFactors:
        """The factors, as PhysX has them; all things have the same."""
        body, own = self._bodies[0], self._own[0]
        friction = body.collision_shapes[0].physical_material.dynamic_friction
        return DynamicsFactors(body.mass / own.mass, friction / own.materials[0].dynamic_friction)

    def set_dynamics(self, dynamics: DynamicsFactors) -> None:
        """Give the task's things other masses and frictions, until the next reset."""
        self._changed = True
        for body, own in zip(self._bodies, self._own, strict=True):
            body.mass, body.inertia = own.mass * dynamics.mass, own.inertia * dynamics.mass
            for shape, material in zip(body.collision_shapes, own.materials, strict=True):
                shape.physical_material = _scaled(material, dynamics.friction)


def _scaled(material: Any, friction: float) -> Any:
    """A material of its own, with the static and dynamic friction scaled."""
    import sapien

    return sapien.physx.PhysxMaterial(
        material.static_friction * friction, material.dynamic_friction * friction, material.restitution
    )


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


def wake(entities: Iterable[Any]) -> None:
    """Reset the time that PhysX has seen each entity with a dynamic body at rest."""
    import sapien

    for entity in entities:
        entity.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent).wake_up()
