"""The action expert: cross-attention from a chunk's steps to the hidden states of every decoder layer."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn import functional

from robogauntlet_mergevla.network.backbone import HiddenStates
from robogauntlet_mergevla.network.config import Architecture

NOISE_STD = 0.02
ROPE_BASE = 10000.0
STEP_BASE = 100.0
"""Longest wavelength of the step encoding over 2 pi: chunks are short, so most of it varies from step to step."""


def rotate(states: Tensor, *, interleaved: bool = False) -> Tensor:
    """Apply rotary position embedding (arXiv 2104.09864) to (..., n, dim) at positions 0 .. n - 1.

    Angles and pairs are both half-split: number i is paired with number i + dim / 2. With `interleaved`, the pairs are
    neighbours but the angles stay half-split, as in the paper's code; this is not a rotation.
    """
    count, dim = states.shape[-2:]
    cos, sin = _rotation(count, dim, interleaved, states.dtype, states.device)
    partners = states.unflatten(-1, (-1, 2)).flip(-1).flatten(-2) if interleaved else states.roll(dim // 2, dims=-1)
    return states * cos + partners * sin


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _rotation(
    count: int, dim: int, interleaved: bool, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Return cosines and sines of the angles, each (count, dim), the sines negative for the first of a pair."""
    frequencies = ROPE_BASE ** (-torch.arange(0, dim, 2, device=device, dtype=torch.float32) / dim)
    angles = torch.arange(count, device=device, dtype=torch.float32)[:, None] * frequencies
    angles = torch.cat([angles, angles], dim=-1)
    first = torch.arange(dim, device=device) % 2 == 0 if interleaved else torch.arange(dim, device=device) < dim // 2
    return angles.cos().to(dtype), torch.where(first, -angles.sin(), angles.sin()).to(dtype)


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def step_encoding(steps: int, width: int) -> Tensor:
    """Return the sinusoidal encoding of a chunk's steps (arXiv 1706.03762), shape (steps, width), on the CPU."""
    frequencies = STEP_BASE ** (-torch.arange(0, width, 2, device="cpu", dtype=torch.float32) / width)
    angles = torch.arange(steps, device="cpu", dtype=torch.float32)[:, None] * frequencies
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1)[:, :width]


class Block(nn.Module):
    """Attention to action states and task states in one softmax, the latter's logits gated; then a feed-forward."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        width = architecture.width
        self.heads, self.options, self.quirks = architecture.expert.heads, architecture.expert, architecture.quirks
        self.q_adapter, self.k_adapter, self.v_adapter = (nn.Linear(width, width) for _ in range(3))
        self.k_task, self.v_task = (nn.Linear(width, width) for _ in range(2))
        if self.options.self_attention:
            self.k_self, self.v_self = (nn.Linear(width, width) for _ in range(2))
        else:
            self.q_task = nn.Linear(width, width)
        self.output = nn.Linear(width, width)
        self.gate = nn.Parameter(torch.zeros(1))
        self.norm = nn.LayerNorm(width)
        self.feed_forward = nn.Linear(width, width)

    def forward(self, steps: Tensor, action: Tensor, task: Tensor) -> Tensor:
        """Return the chunk's next tokens, shape (B, chunk, width).

        Args:
            steps: The chunk's tokens x, shape (B, chunk, width).
            action: h_A with the proprioception's token appended, shape (B, queries + 1, width).
            task: h_T, shape (B, patches, width).
        """
        gate = torch.tanh(self.gate) if self.options.gates_by_tanh else torch.sigmoid(self.gate)
        query = self._rotated(self.q_adapter, steps)
        task_query = query if self.options.self_attention else self._rotated(self.q_task, steps)
        logits = [
            query @ self._rotated(self.k_adapter, action).mT,
            gate * (task_query @ self._rotated(self.k_task, task).mT),
        ]
        values = [self._split(self.v_adapter(action)), self._split(self.v_task(task))]
        if self.options.self_attention:
            logits.append(query @ self._rotated(self.k_self, steps).mT)
            values.append(self._split(self.v_self(steps)))
        weights = torch.softmax(torch.cat(logits, dim=-1) / math.sqrt(query.shape[-1]), dim=-1)
        attended = (weights @ torch.cat(values, dim=2)).transpose(1, 2).flatten(2)
        steps = steps + self.output(attended)
        fed = functional.relu(self.feed_forward(self.norm(steps)))
        return fed if self.quirks.ffn_without_skip else steps + fed

    def _rotated(self, projection: nn.Linear, states: Tensor) -> Tensor:
        return rotate(self._split(projection(states)), interleaved=self.quirks.interleaved_rope)

    def _split(self, states: Tensor) -> Tensor:
        """(B, n, width) to (B, heads, n, width / heads)."""
        return states.view(*states.shape[:2], self.heads, -1).transpose(1, 2)


class ActionExpert(nn.Module):
    """Initial tokens, a block per decoder layer, and the output layer."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        width, entry = architecture.width, architecture.action_dim * architecture.width
        self.input_norm = nn.LayerNorm(entry)
        self.input = nn.Linear(entry, width)
        self.blocks = nn.ModuleList(Block(architecture) for _ in range(architecture.language.layers))
        self.output_norm = nn.LayerNorm(width)
        self.output = nn.Linear(width, architecture.action_dim)

    def forward(self, hidden: HiddenStates, proprioception: Tensor) -> Tensor:
        """Return the normalised action chunk, shape (B, chunk, action_dim).

        Args:
            hidden: The backbone's hidden states; block i (from 1) reads index i.
            proprioception: The proprioception's token p, shape (B, width).
        """
        steps = functional.relu(self.input(self.input_norm(self._initial_tokens(proprioception))))
        for block, action, task in zip(self.blocks, hidden.action[1:], hidden.task[1:], strict=True):
            steps = block(steps, torch.cat([action, proprioception[:, None]], dim=1), task)
        return self.output(self.output_norm(steps))

    def _initial_tokens(self, like: Tensor) -> Tensor:
        """Return the tokens before the first layer, shape (B, chunk, action_dim * width). They have no parameters."""
        shape = (like.shape[0], self.architecture.chunk_length, self.input.in_features)
        if not self.architecture.quirks.training_noise:
            return step_encoding(*shape[1:]).to(like).expand(shape)
        return torch.randn(shape).to(like) * NOISE_STD if self.training else torch.zeros(shape).to(like)
