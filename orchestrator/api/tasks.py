"""`robogauntlet.make`: open a task as an environment of gymnasium."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments.environment import assets_variables, read_config
from robogauntlet.orchestrator.registry import why_impossible
from robogauntlet.suites.conditions import read_condition
from robogauntlet.suites.episode import CLEAN, Cell, Protocol, RenderProfile, SuccessRule, View
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

if TYPE_CHECKING:
    from robogauntlet.orchestrator.api.task_environment import TaskEnvironment

RENDER_MODES = ("rgb_array",)


def make(
    task: str,
    *,
    render_mode: str | None = None,
    cameras: Sequence[str] | None = None,
    image_size: int = 96,
    render_profile: str = RenderProfile.STANDARD,
    horizon: int | None = None,
    condition: str = CLEAN,
    success: str = SuccessRule.HELD,
) -> TaskEnvironment:
    """Open a task in this process as a `gymnasium.Env`, to step a policy in a loop of your own.

    An observation is a mapping with the parameters of a policy's function, so that `act(**observation)` is its chunk.

    Args:
        task: `simulator/task`.
        render_mode: `rgb_array` for a `render()` that returns the third-person view, (256, 256, 3) uint8; or None.
        cameras: Cameras of an observation, out of `third_person` and `wrist`; by default all of the task.
        image_size: Height and width of their images (px), 16 to 1024.
        render_profile: `standard`, `fast` or `fast-2`.
        horizon: Control steps after which an episode is truncated; by default that of the task.
        condition: `clean`, or one perturbation axis at one severity, `AXIS@SEVERITY`. Each seed has the disturbance
            that it has in a run with the same horizon, cameras, image size and profile, and the default of eight
            actions between queries. A perturbation that cannot be delivered raises `NotDelivered` during `reset`.
        success: `held`, or `once` to succeed at the first step after which the task's predicate holds.

    Raises:
        AdapterError: There is no such task, or its simulator is not installed.
        BadInput: An argument is not as described, or gymnasium is not installed.
    """
    if render_mode not in (None, *RENDER_MODES):
        raise BadInput(f"render_mode: expected rgb_array or None, got {render_mode!r}")
    if not 16 <= image_size <= 1024:
        raise BadInput(f"image_size: expected 16 to 1024, got {image_size}")
    if render_profile not in list(RenderProfile):
        raise BadInput(f"render_profile: unknown '{render_profile}'{did_you_mean(render_profile, RenderProfile)}")
    if success not in list(SuccessRule):
        raise BadInput(f"success: unknown '{success}'{did_you_mean(success, SuccessRule)}")
    if horizon is not None and horizon < 1:
        raise BadInput(f"horizon: expected 1 or more, got {horizon}")
    shift = read_condition(condition)
    description = catalog.task_descriptions().get(task)
    available = description.cameras if description else ()
    for camera in cameras or () if description else ():
        if camera not in available:
            raise BadInput(f"cameras: {task} has no camera '{camera}'{did_you_mean(camera, available)}")
    if description and (why := why_impossible(shift, task)):
        raise BadInput(f"condition '{condition}': unsupported in {task}: {why}")
    try:
        from robogauntlet.orchestrator.api.task_environment import TaskEnvironment
    except ModuleNotFoundError as error:
        raise BadInput(f"not installed (no module {error.name}); install it: pip install gymnasium") from None
    if description:  # variables are set before the simulator is imported
        own = catalog.find(task.partition("/")[0]).environment
        for name, value in {**own, **assets_variables(read_config())}.items():
            os.environ.setdefault(name, value)
    view = View(tuple(cameras or available), image_size, RenderProfile(render_profile))
    simulation = catalog.open_simulation(task, view)
    assert description is not None  # else it was refused
    protocol = Protocol(horizon or description.horizon, view=view, success=SuccessRule(success))
    return TaskEnvironment(simulation, description, Cell("own loop", "own loop", task, protocol, shift), render_mode)
