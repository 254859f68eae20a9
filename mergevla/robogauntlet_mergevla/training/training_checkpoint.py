"""State of a training for resuming it: one safetensors file whose header holds the history as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.files import replacing
from robogauntlet.support.json_text import parse_json
from robogauntlet_mergevla.checkpoints.expert_checkpoint import write_tensors

STATE_FILE = "training.safetensors"
MOMENTS = ("exp_avg", "exp_avg_sq")


class TrainingError(PolicyError):
    """A training that cannot be started or resumed."""


@dataclass
class History:
    """Progress and measurements of a training."""

    identity: str
    """Hash of everything that decides the final weights."""
    step: int = 0
    """Steps taken."""
    seconds: float = 0.0
    losses: list[float] = field(default_factory=list)
    """Training loss of each step."""
    held_out: list[tuple[int, float]] = field(default_factory=list)
    """Steps taken, and the loss on held-out episodes then."""


def save_state(path: Path, weights: Mapping[str, nn.Parameter], optimiser: torch.optim.AdamW, history: History) -> None:
    """Write trained weights, AdamW's moments and the history. The file appears only once it is complete."""
    tensors = {f"weight/{name}": weight.detach().cpu().contiguous() for name, weight in weights.items()}
    for name, weight in weights.items():
        moments = optimiser.state[weight]
        tensors |= {f"{kind}/{name}": moments[kind].detach().cpu().contiguous() for kind in MOMENTS if moments}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        write_tensors(tensors, partial, metadata={"training": json.dumps(asdict(history))})


def load_state(
    path: Path, weights: Mapping[str, nn.Parameter], optimiser: torch.optim.AdamW, identity: str
) -> History | None:
    """Restore weights and moments from the file if it exists.

    Raises TrainingError if the file is malformed, or of another training than `identity`'s.
    """
    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            plain = parse_json(file.metadata()["training"])
            history = History(**{**plain, "held_out": [(int(step), float(loss)) for step, loss in plain["held_out"]]})
            tensors: dict[str, Tensor] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, TypeError, KeyError, ValueError) as error:
        raise TrainingError(f"{path}: expected a training's state, got one that does not read: {error}") from None
    if history.identity != identity:
        raise TrainingError(
            f"{path.parent}: expected the same data, base and settings to continue its training, got others; "
            f"choose another folder or delete {STATE_FILE} there"
        )
    try:
        _fill(weights, optimiser, tensors, history.step)
    except (KeyError, RuntimeError) as error:
        raise TrainingError(f"{path}: expected this network's tensors, got others: {error}") from None
    return history


@torch.no_grad()
def _fill(
    weights: Mapping[str, nn.Parameter], optimiser: torch.optim.AdamW, tensors: Mapping[str, Tensor], steps: int
) -> None:
    """Restore tensors. A weight without gradient, such as of a vision tower's last block, has no moments."""
    for name, weight in weights.items():
        weight.copy_(tensors[f"weight/{name}"])
        if any(f"{kind}/{name}" in tensors for kind in MOMENTS):
            moments = {kind: tensors[f"{kind}/{name}"].to(weight.device) for kind in MOMENTS}
            # On the weight's device, where fused AdamW reads it.
            optimiser.state[weight] = {"step": torch.tensor(float(steps), device=weight.device), **moments}
