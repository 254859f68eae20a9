"""A Qwen2 decoder (arXiv 2407.10671) that returns every layer.

It computes to the bit what `transformers.Qwen2Model` does, and names its weights alike. That one's modules import
torch's compiler and its distributed tensors, for several seconds of processor time in every process that acts.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from robogauntlet_mergevla.network.config import LanguageModel

INITIAL_STD = 0.02
Rotation = tuple[Tensor, Tensor]
"""Cosines and sines of the rotary embedding (arXiv 2104.09864), each of shape (B, 1, length, head's width)."""


class Norm(nn.Module):
    """Divides by the root mean square, in fp32."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(width))

    def forward(self, states: Tensor) -> Tensor:
        """Shape (..., width) to the same."""
        wide = states.float()
        return self.weight * (wide * torch.rsqrt(wide.pow(2).mean(-1, keepdim=True) + 1e-6)).to(states.dtype)


class Attention(nn.Module):
    """Self-attention with rotated queries and keys; several heads share one of keys and values."""

    def __init__(self, config: LanguageModel) -> None:
        super().__init__()
        self.head = config.width // config.heads
        self.shared_by = config.heads // config.key_value_heads
        self.q_proj = nn.Linear(config.width, config.heads * self.head)
        self.k_proj = nn.Linear(config.width, config.key_value_heads * self.head)
        self.v_proj = nn.Linear(config.width, config.key_value_heads * self.head)
        self.o_proj = nn.Linear(config.heads * self.head, config.width, bias=False)

    def forward(self, states: Tensor, allowed: Tensor, rotation: Rotation) -> Tensor:
        """Shape (B, length, width) to the same; `allowed` as for the decoder."""
        parts = (project(states).unflatten(-1, (-1, self.head)) for project in (self.q_proj, self.k_proj, self.v_proj))
        queries, keys, values = (part.transpose(1, 2) for part in parts)
        queries, keys = _rotated(queries, rotation), _rotated(keys, rotation)
        if self.shared_by > 1:
            keys, values = (part.repeat_interleave(self.shared_by, dim=1) for part in (keys, values))
        attended = functional.scaled_dot_product_attention(queries, keys, values, attn_mask=allowed)
        return self.o_proj(attended.transpose(1, 2).flatten(2))


class FeedForward(nn.Module):
    """A gated layer (arXiv 2002.05202)."""

    def __init__(self, config: LanguageModel) -> None:
        super().__init__()
        self.gate_proj = nn.Linear(config.width, config.feed_forward, bias=False)
        self.up_proj = nn.Linear(config.width, config.feed_forward, bias=False)
        self.down_proj = nn.Linear(config.feed_forward, config.width, bias=False)

    def forward(self, states: Tensor) -> Tensor:
        """Shape (..., width) to the same."""
        return self.down_proj(functional.silu(self.gate_proj(states)) * self.up_proj(states))


class Layer(nn.Module):
    """Attention, then the feed-forward layer, each on normalised states and with a skip connection."""

    def __init__(self, config: LanguageModel) -> None:
        super().__init__()
        self.self_attn = Attention(config)
        self.mlp = FeedForward(config)
        self.input_layernorm = Norm(config.width)
        self.post_attention_layernorm = Norm(config.width)

    def forward(self, states: Tensor, allowed: Tensor, rotation: Rotation) -> Tensor:
        """Shape (B, length, width) to the same; `allowed` as for the decoder."""
        states = states + self.self_attn(self.input_layernorm(states), allowed, rotation)
        return states + self.mlp(self.post_attention_layernorm(states))


class Embedding(nn.Embedding):
    """Words' embeddings. Drawing values for a weight that has no memory would import torch's compiler (3 s)."""

    def reset_parameters(self) -> None:
        """Draw the weight, if it has memory."""
        if not self.weight.is_meta:
            super().reset_parameters()


class Decoder(nn.Module):
    """The decoder. `embed_tokens` gives words' embeddings, shape (B, words) to (B, words, width)."""

    def __init__(self, config: LanguageModel) -> None:
        super().__init__()
        self.embed_tokens = Embedding(config.vocabulary, config.width)
        self.layers = nn.ModuleList(Layer(config) for _ in range(config.layers))
        self.norm = Norm(config.width)
        head = config.width // config.heads
        frequencies = 1.0 / config.rope_theta ** (torch.arange(0, head, 2, dtype=torch.float) / head)
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.apply(_initialise)

    def forward(self, sequence: Tensor, positions: Tensor, allowed: Tensor) -> list[Tensor]:
        """Return the embeddings and the states after each layer, the last one's normalised.

        Args:
            sequence: Embeddings, shape (B, length, width); so are the states.
            positions: Position of each token, shape (B, length).
            allowed: Which tokens each one attends to, shape (B or 1, 1, length or 1, length).
        """
        with torch.no_grad():
            angles = positions[..., None].float() * self.frequencies.float()
            both = torch.cat((angles, angles), dim=-1)[:, None]
            rotation = both.cos().to(sequence.dtype), both.sin().to(sequence.dtype)
        states = [sequence]
        for layer in self.layers:
            states.append(layer(states[-1], allowed, rotation))
        states[-1] = self.norm(states[-1])
        return states


def _rotated(states: Tensor, rotation: Rotation) -> Tensor:
    cosines, sines = rotation
    first, second = states.chunk(2, dim=-1)
    return states * cosines + torch.cat((-second, first), dim=-1) * sines


def _initialise(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Embedding) and not module.weight.is_meta:
        nn.init.normal_(module.weight, std=INITIAL_STD)
    if isinstance(module, nn.Linear) and module.bias is not None:
        nn.init.zeros_(module.bias)
