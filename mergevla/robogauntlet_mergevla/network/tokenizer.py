"""Tokenizes instructions, with padding that does not change the network's result."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from robogauntlet.policies.contract import PolicyError
from robogauntlet.support.errors import first_line
from robogauntlet_mergevla.network.config import Architecture

SYSTEM = "You are Qwen, created by Alibaba Cloud. You are a helpful assistant."
QUESTION = "What action should the robot take to {instruction}?"
PADDING, START, RESERVED = 0, 1, 2


@dataclass(frozen=True)
class Prompts:
    """A batch of prompts, padded after the first token.

    First and last token are thus in fixed columns for any length, which the paper's order of the sequence needs.
    """

    ids: Tensor
    """Token ids, shape (B, T)."""
    present: Tensor
    """False for padding, shape (B, T)."""

    def to(self, device: torch.device) -> Prompts:
        """Return the same prompts on another device."""
        return Prompts(self.ids.to(device), self.present.to(device))


Tokenizer = Callable[[Sequence[str]], Prompts]
"""Turns instructions into prompts."""


def word_ids(instruction: str, vocabulary: int) -> list[int]:
    """Return the ids of a start token and of the words, each a stable hash of the word in lower case."""
    words = re.findall(r"[a-z0-9]+", instruction.lower())
    hashes = [int.from_bytes(hashlib.sha256(word.encode()).digest()[:4], "big") for word in words]
    return [START, *(RESERVED + value % (vocabulary - RESERVED) for value in hashes)]


def tokenizer_for(architecture: Architecture) -> Tokenizer:
    """Return the architecture's tokenizer. Chat prompts follow the paper's code. PolicyError if it cannot be loaded."""
    length = architecture.prompt_tokens
    if architecture.tokenizer == "words":
        return lambda instructions: _pad([word_ids(i, architecture.language.vocabulary) for i in instructions], length)
    from transformers import AutoTokenizer

    try:
        pretrained = AutoTokenizer.from_pretrained(architecture.tokenizer)
    except (OSError, ValueError) as error:
        raise PolicyError(f"expected a tokenizer at '{architecture.tokenizer}', got: {first_line(error)}") from None

    def encode(instructions: Sequence[str]) -> Prompts:
        return _pad([_chat(pretrained, instruction) for instruction in instructions], length)

    return encode


def _chat(pretrained: object, instruction: str) -> list[int]:
    messages = [
        {"role": "system", "content": SYSTEM},
        {"role": "user", "content": QUESTION.format(instruction=instruction.lower())},
    ]
    text = pretrained.apply_chat_template(messages, tokenize=False, add_generation_prompt=True)  # type: ignore[attr-defined]
    return pretrained.encode(text, add_special_tokens=False)  # type: ignore[attr-defined]


def _pad(rows: Sequence[Sequence[int]], length: int) -> Prompts:
    """Pad token ids to `length`, or to the longest row, as `Prompts` describes."""
    length = max(length, max(map(len, rows), default=0))
    ids = torch.full((len(rows), length), PADDING, dtype=torch.long)
    present = torch.zeros((len(rows), length), dtype=torch.bool)
    for index, row in enumerate(rows):
        rest = len(row) - 1
        ids[index, 0], present[index, 0] = row[0], True
        if rest:
            ids[index, -rest:] = torch.tensor(row[1:])
            present[index, -rest:] = True
    return Prompts(ids, present)
