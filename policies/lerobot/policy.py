"""The policy kind `lerobot`. Light: the policy's module is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from robogauntlet.policies.contract import Policy, PolicyFiles, PolicyKind, PolicySpec, Wishes
from robogauntlet.policies.lerobot.checkpoint import NAME, OPTIONS, files, read_checkpoint


def _load(options: Mapping[str, Any]) -> Policy:
    from robogauntlet.policies.lerobot.lerobot_policy import LeRobotPolicy

    return LeRobotPolicy(read_checkpoint(options))


def _digest(options: Mapping[str, Any]) -> str:
    return read_checkpoint(options).digest()


def _spec(options: Mapping[str, Any]) -> PolicySpec:
    return read_checkpoint(options).spec


def _wishes(options: Mapping[str, Any]) -> Wishes:
    checkpoint = read_checkpoint(options)
    return replace(checkpoint.options.wishes, execute=checkpoint.spec.chunk_length)


def _files(options: Mapping[str, Any]) -> PolicyFiles:
    folder = read_checkpoint(options).folder
    return PolicyFiles({"checkpoint": folder}, files(folder))


KIND = PolicyKind(
    name=NAME,
    summary="a checkpoint of LeRobot: lerobot:FOLDER, or lerobot:USER/NAME on the hub",
    load=_load,
    digest=_digest,
    digest_without_start=_digest,
    spec=_spec,
    wishes=_wishes,
    options=OPTIONS,
    files=_files,
    modules=("lerobot",),
    imports="robogauntlet.policies.lerobot.child:import_lerobot",
    distributions=("lerobot", "torch", "torchvision", "transformers"),
    requirements=(
        "torch==2.13.0",
        "torchvision==0.28.0",
        "transformers==5.3.0",
        "huggingface_hub==1.33.0",
        "datasets==4.1.1",
        "diffusers==0.35.2",
        "draccus==0.10.0",
        "einops==0.8.2",
        "av==15.1.0",
        "deepdiff==8.6.1",
        "pyserial==3.5",
        "accelerate>=1.10",
        "gymnasium>=1.0",
        "imageio>=2.34",
        "termcolor>=2.4",
    ),
    without_dependencies=("lerobot==0.4.4",),
    preferred=dict.fromkeys(("3.12", "3.13"), ("lerobot[diffusion,pi,smolvla]==0.6.1",)),
)
