"""Makes ManiSkill's environments, and finds a device on which SAPIEN renders."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.maniskill.assets import described, use_folder
from robogauntlet.adapters.package_files import files_of
from robogauntlet.suites.episode import AT


def make_environment(task: str, cameras: Callable[[Any], Mapping[str, Any]], **arguments: Any) -> Any:
    """Make the environment of a task, on the CPU, without observations.

    Args:
        task: Its name here, ManiSkill's before an `@`.
        cameras: Returns arguments, given ManiSkill's `look_at`.
        arguments: Others of the environment's class.

    Raises:
        SimulatorUnavailable: ManiSkill or a file of it is missing, or SAPIEN finds no Vulkan device to render with.
    """
    use_folder()
    try:
        import mani_skill.envs  # noqa: F401  (registers the tasks)
        import sapien
        import torch
        from mani_skill.utils.logging_utils import logger
        from mani_skill.utils.registration import REGISTERED_ENVS
        from mani_skill.utils.sapien_utils import look_at
    except ImportError as error:
        raise SimulatorUnavailable(
            f'ManiSkill cannot be imported ({error}); install it: pip install "robogauntlet[maniskill]"'
        ) from error
    torch.set_num_threads(1)  # More threads do not help a single environment, and slow other workers down.
    # ManiSkill warns that the tasks do not list this robot, but their scene builder supports it.
    logger.setLevel(logging.ERROR)
    try:
        with files_of("mani_skill"):
            env = REGISTERED_ENVS[task.partition(AT)[0]].cls(
                num_envs=1,
                obs_mode="none",
                sim_backend="physx_cpu",
                render_backend=_render_backend(sapien),
                **cameras(look_at),
                **arguments,
            )
    except RuntimeError as error:
        raise SimulatorUnavailable(f"SAPIEN cannot render here ({error}): {_VULKAN_FIX}") from error
    if not env.scene.can_render():
        env.close()
        raise SimulatorUnavailable(f"SAPIEN found no device to render with: {_VULKAN_FIX}")
    _keep_renderer(env.scene.backend.render_device)
    return env


_VULKAN_FIX = (
    "install a Vulkan driver: that of the GPU's vendor, or without a GPU the Debian packages libvulkan1 and "
    "mesa-vulkan-drivers, version 24.3 or later"
)


def _render_backend(sapien: Any) -> str:
    """Return `gpu` if SAPIEN can render on a CUDA device, else `cpu` for Mesa's lavapipe."""
    try:
        return "gpu" if sapien.Device("cuda").can_render() else "cpu"
    except RuntimeError:
        return "cpu"


_RENDERERS: dict[str, Any] = {}
"""Name of a device to its renderer."""


def _keep_renderer(device: Any) -> None:
    """Keep a reference to the device's renderer for the lifetime of the process.

    Otherwise SAPIEN would free its renderer with the last scene and compile its shaders again (7 s, and more memory).
    A GPU's name is that of its model, by which SAPIEN does not find it, so the device itself is used.
    """
    import sapien

    if device.name not in _RENDERERS:
        _RENDERERS[device.name] = sapien.render.RenderSystem(device)


def render_device() -> str:
    """Return the name of the Vulkan device, such as `llvmpipe (LLVM 19.1.7, 256 bits)`, and the hash of assets."""
    import sapien

    return described(_device_name(sapien.render.get_device_summary()))


def _device_name(summary: str) -> str:
    """Return the first supported device in SAPIEN's summary."""
    name = "unknown"
    for line in summary.splitlines():
        label, _, value = line.strip().partition(":")
        if label == "GPU":
            name = value.strip()
        elif label == "Supported" and value.strip() == "1":
            return name
    return name
