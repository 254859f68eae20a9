"""The whole network: backbone, action queries, proprioception and action expert."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from accelerate import init_empty_weights
from torch import Tensor, nn

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.network.action_expert import ActionExpert
from robogauntlet_mergevla.network.backbone import Backbone, HiddenStates
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.network.tokenizer import Prompts

QUERY_STD = 0.02
EMBEDDINGS = "backbone.language.embed_tokens.weight"


class MergeVLA(nn.Module):
    """MergeVLA (arXiv 2511.18810).

    Its parts, by the first words of a weight's name:

    - `backbone`: the vision-language model that task vectors and masks are about;
    - `action_queries`, `proprioception`, `action_expert.input*`, `action_expert.blocks.<i>`: the trunk;
    - the last k of the blocks and `action_expert.output*`: the head that a task keeps.
    """

    def __init__(self, architecture: Architecture, backbone: Backbone | None = None) -> None:
        super().__init__()
        self.architecture = architecture
        width = architecture.width
        self.backbone = backbone or Backbone(architecture)
        self.action_queries = nn.Parameter(torch.randn(architecture.action_queries, width) * QUERY_STD)
        self.proprioception = nn.Sequential(
            nn.Linear(architecture.proprioception_dim, width), nn.GELU(), nn.Linear(width, width)
        )
        self.action_expert = ActionExpert(architecture)

    def forward(self, images: Tensor, prompts: Prompts, proprioception: Tensor) -> Tensor:
        """Return the normalised action chunk, shape (B, chunk, 7).

        Args:
            images: Shape (B, cameras, 3, H, W), in [0, 1]; PolicyError for another shape than the architecture's.
            prompts: The instructions, batch B.
            proprioception: Normalised to [-1, 1], shape (B, 8).
        """
        return self.act(self.hidden_states(images, prompts), proprioception)

    def hidden_states(self, images: Tensor, prompts: Prompts) -> HiddenStates:
        """Compute the backbone's part of `forward`: (h_T, h_A) of every layer, the input of a router."""
        return self.backbone(images.to(self.action_queries.dtype), prompts, self.action_queries)

    def act(self, hidden: HiddenStates, proprioception: Tensor) -> Tensor:
        """Compute the action expert's part of `forward`."""
        expected = self.architecture.proprioception_dim
        if proprioception.ndim != 2 or proprioception.shape[1] != expected:
            raise PolicyError(f"expected proprioception of shape (B, {expected}), got {tuple(proprioception.shape)}")
        return self.action_expert(hidden, self.proprioception(proprioception.to(self.action_queries.dtype)))


def build(architecture: Architecture, seed: int) -> MergeVLA:
    """Return a network with random weights that depend on `seed` alone; the global generator is unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return MergeVLA(architecture)


def trunk(architecture: Architecture, seed: int) -> dict[str, Tensor]:
    """Return random weights of everything but the backbone, which depend on `seed` alone."""
    with torch.random.fork_rng(devices=[]):
        with init_empty_weights(include_buffers=False):
            backbone = Backbone(architecture)
        torch.manual_seed(seed)
        weights = MergeVLA(architecture, backbone).state_dict()
    return {name: weight for name, weight in weights.items() if not name.startswith("backbone.")}


def empty(architecture: Architecture) -> MergeVLA:
    """Return a network whose weights are yet to be assigned, and take no memory; the global generator is unchanged."""
    with torch.random.fork_rng(devices=[]), init_empty_weights(include_buffers=False):
        return MergeVLA(architecture)


def assembled(architecture: Architecture, weights: Mapping[str, Tensor]) -> MergeVLA:
    """Return the network with these weights, all in the type of its backbone's, in which it then computes."""
    dtype = weights[EMBEDDINGS].dtype
    model = empty(architecture)
    model.load_state_dict({name: weight.to(dtype) for name, weight in weights.items()}, assign=True)
    return model


def count(*modules: nn.Module) -> int:
    """Return the number of parameters of modules."""
    return sum(parameter.numel() for module in modules for parameter in module.parameters())
