"""What experts say about an observation without any label: by their weights, their actions, and the base's.

Fine-tuning starts from a base. An expert's delta to it acts least where the base's layers receive what the expert was
trained on, and more on the inputs of other tasks. (The opposite sign, by which adapters are routed to the inputs that
excite them most, as in O. Ostapenko et al., arXiv 2405.11157, is right less often than chance here.)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from robogauntlet.policies.contract import Routing
from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.network.lora import BACKBONE
from robogauntlet_mergevla.network.normalisation import padded
from robogauntlet_mergevla.routing.contract import FirstObservation, RoutingError, answer, hidden_states

NOISE = 0.05
"""Standard deviation of the noise on images in [0, 1]."""
SMALLEST = 1e-12
"""Lower bound of an energy, before its logarithm."""


def directions(model: MergedModel, rank: int | None = None) -> dict[str, Tensor]:
    """Return each backbone layer's deltas, as matrices (experts, rows, inputs) by the layer's name.

    Args:
        model: Merged model.
        rank: How many right singular vectors of a delta are its rows, at most a quarter of the inputs. By default the
            delta itself, divided by its Frobenius norm.

    Raises:
        RoutingError: No layer of any expert differs from the base's.
    """
    base = model.weights(None)
    linear = {name for name, module in model.model(None).backbone.named_modules() if isinstance(module, nn.Linear)}
    deltas: dict[str, list[Tensor]] = {name: [] for name in sorted(linear)}
    for expert in model.experts:
        weights = model.weights(expert)
        for name, own in deltas.items():
            key = f"{BACKBONE}{name}.weight"
            own.append(weights[key].float() - base[key].float())
    for changed in (all, any):  # layers that masks leave unchanged in some expert only if there are no others
        if kept := [name for name, own in deltas.items() if changed(bool(delta.any()) for delta in own)]:
            return {name: torch.stack([_rows(delta, rank) for delta in deltas[name]]).to(model.device) for name in kept}
    raise RoutingError("expected experts that differ from the base in a layer of the backbone, got none")


def energies(
    model: MergedModel,
    rows: Mapping[str, Tensor],
    observations: Sequence[FirstObservation],
    *,
    sees_instruction: bool,
) -> Tensor:
    """Logarithm of the mean over tokens of ||P x||^2 / ||x||^2, shape (n, layers, experts), on the CPU.

    x is a token's input to a layer in a pass of the base, P are the rows of `directions`, by layer in their order.
    """
    batches = []
    with _inputs(model.model(None).backbone, rows) as inputs:
        for hidden in hidden_states(model, None, observations, sees_instruction=sees_instruction):
            layers, count = [], len(hidden.task[0])
            for name, matrices in rows.items():
                x = torch.nn.functional.normalize(inputs[name].float(), dim=-1)
                projected = torch.einsum("bti,eri->bter", x, matrices)
                found = projected.square().sum(dim=-1)
                # Towers see each camera's image as an observation of its own.
                layers.append(found.reshape(count, -1, found.shape[-1]).mean(dim=1).clamp(min=SMALLEST).log())
            batches.append(torch.stack(layers, dim=1).cpu())
    return torch.cat(batches)


def agreement(model: MergedModel, observations: Sequence[FirstObservation]) -> Tensor:
    """How far the actions of each expert's network and of the base agree, shape (n, experts), on the CPU: from -1 to 0.

    Both are given an instruction that the expert was trained with, never the observation's: minus the L1 distance of
    the two normalised chunks over the sum of their L1 norms. Of an expert of several tasks, the best agreement counts.
    """
    pairs = (
        (chunks_told(model, expert, expert, observations), chunks_told(model, expert, None, observations))
        for expert in model.experts
    )
    return torch.stack([_likeness(own, base) for own, base in pairs], dim=1).cpu()


def stability(model: MergedModel, observations: Sequence[FirstObservation]) -> Tensor:
    """How little each expert's actions change when noise is added to the images, shape (n, experts): from -1 to 0.

    As `agreement`, of an expert's chunks with and without noise of standard deviation `NOISE`, which depends on the
    episode alone. An expert is at home where its actions are stable.
    """
    varied = [replace(one, images=_noisy(one)) for one in observations]
    pairs = ((chunks_told(model, expert, expert, seen) for seen in (observations, varied)) for expert in model.experts)
    return torch.stack([_likeness(*pair) for pair in pairs], dim=1).cpu()


class DeltaEnergyRouter:
    """Chooses the expert whose delta acts least on the base's inputs, relative to the delta's size.

    r_m = - sum over layers of log mean_tokens ||D_m x||^2 / (||D_m||_F^2 ||x||^2), with D_m the weights of expert m's
    network less the base's. No labels, no other observations, and one pass of the base for any number of experts.
    Keeps each D_m of every linear layer in memory, in fp32.
    """

    name = "delta-energy"

    def __init__(self, *, sees_instruction: bool = True) -> None:
        self.sees_instruction = sees_instruction
        self._fitted_to: MergedModel | None = None
        self._rows: dict[str, Tensor] = {}

    def passes(self, experts: int) -> int:
        """One pass of the base, for any number of experts."""
        return 1

    def route(self, observations: Sequence[FirstObservation], model: MergedModel) -> list[Routing]:
        """Route each observation, in order. Raises RoutingError if no layer differs from the base's."""
        if self._fitted_to is not model:
            self._rows, self._fitted_to = directions(model), model
        if not observations:
            return []
        found = energies(model, self._rows, observations, sees_instruction=self.sees_instruction)
        return [answer(dict(zip(model.experts, row, strict=True))) for row in (-found.sum(dim=1)).tolist()]


def _rows(delta: Tensor, rank: int | None) -> Tensor:
    if rank is None:
        return delta / delta.norm().clamp(min=SMALLEST)
    vectors = torch.linalg.svd(delta, full_matrices=False).Vh[: max(1, min(rank, delta.shape[1] // 4))]
    return vectors if delta.any() else torch.zeros_like(vectors)


@contextmanager
def _inputs(backbone: nn.Module, names: Mapping[str, Tensor]) -> Iterator[dict[str, Tensor]]:
    """Provide the latest inputs (B, tokens, width) of layers, by name."""
    kept: dict[str, Tensor] = {}

    def keep(name: str, module: nn.Module, arguments: tuple[Tensor, ...]) -> None:
        kept[name] = arguments[0]

    modules = dict(backbone.named_modules())
    hooks = [modules[name].register_forward_pre_hook(partial(keep, name)) for name in names]
    try:
        yield kept
    finally:
        for hook in hooks:
            hook.remove()


def chunks_told(
    model: MergedModel, expert: str, network: str | None, observations: Sequence[FirstObservation]
) -> Tensor:
    """Normalised chunks of a network told each instruction that an expert was trained with, (tasks, n, chunk, used)."""
    numbers, statistics = model.architecture.proprioception_dim, model.parts.statistics
    states = np.stack([padded(observation.proprioception, numbers) for observation in observations])
    normalised = statistics.normalise_proprioception([expert] * len(states), states)
    used = torch.from_numpy(statistics.is_used([expert], model.architecture.action_dim)[0])
    told = (
        [replace(one, instruction=model.instructions[task]) for one in observations] for task in model.tasks[expert]
    )
    return torch.stack([_chunks(model, network, asked, normalised)[..., used] for asked in told])


def _noisy(observation: FirstObservation) -> Tensor:
    generator = np.random.default_rng(int(content_hash({"noisy": observation.episode_id}), 16))
    noise = generator.normal(scale=NOISE, size=tuple(observation.images.shape))
    return (observation.images + torch.from_numpy(noise).to(observation.images)).clamp(0, 1)


def _likeness(one: Tensor, other: Tensor) -> Tensor:
    """Minus the L1 distance of chunks over the sum of their L1 norms, of the best task: (tasks, n, ...) to (n,)."""
    norms = (one.abs() + other.abs()).mean(dim=(2, 3)).clamp(min=SMALLEST)
    return (-(one - other).abs().mean(dim=(2, 3)) / norms).amax(dim=0)


@torch.inference_mode()
def _chunks(
    model: MergedModel, network: str | None, observations: Sequence[FirstObservation], states: np.ndarray
) -> Tensor:
    """Return normalised chunks (n, chunk, action_dim); states are normalised, (n, 8)."""
    chunks: list[Tensor] = []
    done = 0
    for hidden in hidden_states(model, network, observations, sees_instruction=True):
        batch = torch.from_numpy(states[done : done + len(hidden.task[0])]).float().to(model.device)
        chunks.append(model.model(network).act(hidden, batch))
        done += len(batch)
    return torch.cat(chunks)
