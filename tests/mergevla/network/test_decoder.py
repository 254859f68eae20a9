"""The decoder computes to the bit what `transformers` does, from the same seed and weights, and needs none of it."""

import subprocess
import sys

import pytest
import torch

from robogauntlet_mergevla.network.config import LanguageModel
from robogauntlet_mergevla.network.decoder import Decoder

ALONE = """
import sys
from robogauntlet_mergevla.kinds import EXPERTS, KIND, MERGED
KIND.load({"checkpoint": "zoo:base"})
EXPERTS.load({"folder": "zoo:experts"})
MERGED.load({"checkpoint": "zoo:merged"})
print(sorted({"transformers", "peft", "sympy", "torch._dynamo"} & sys.modules.keys()))
"""


def qwen(config):
    """The same decoder of `transformers`."""
    from transformers import Qwen2Config, Qwen2Model

    return Qwen2Model(
        Qwen2Config(
            vocab_size=config.vocabulary,
            hidden_size=config.width,
            intermediate_size=config.feed_forward,
            num_hidden_layers=config.layers,
            num_attention_heads=config.heads,
            num_key_value_heads=config.key_value_heads,
            rope_parameters={"rope_type": "default", "rope_theta": config.rope_theta},
            attn_implementation="sdpa",
        )
    )


@pytest.mark.parametrize("shared_by", [1, 2])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_states_weights_and_gradients_are_those_of_transformers(shared_by, dtype):
    config = LanguageModel(32, layers=2, heads=4, key_value_heads=4 // shared_by, feed_forward=48, vocabulary=64)
    torch.manual_seed(3)
    theirs = qwen(config)
    torch.manual_seed(3)
    ours = Decoder(config)
    assert all(torch.equal(weight, theirs.state_dict()[name]) for name, weight in ours.state_dict().items())
    assert ours.state_dict().keys() == theirs.state_dict().keys()
    for model in (ours, theirs):
        for parameter in model.parameters():
            parameter.data = parameter.data.to(dtype)
    words = torch.randint(64, (3, 20))
    present = torch.arange(20) < torch.tensor([[20], [13], [7]])
    positions = (present.long().cumsum(1) - 1).clamp(min=0)
    allowed = present[:, None, None, :] & torch.ones(20, 20, dtype=torch.bool).tril()
    sequence = theirs.embed_tokens(words).detach()
    expected, rotation = [sequence], theirs.rotary_emb(sequence, positions)
    for block in theirs.layers:
        expected.append(block(expected[-1], attention_mask=allowed, position_embeddings=rotation))
    expected[-1] = theirs.norm(expected[-1])
    states = ours(sequence, positions, allowed)
    assert all(torch.equal(one, other) for one, other in zip(states, expected, strict=True))
    for last in (states[-1], expected[-1]):
        last.float().square().sum().backward()
    gradients = {name: weight.grad for name, weight in theirs.named_parameters()}
    assert all(torch.equal(w.grad, gradients[name]) for name, w in ours.named_parameters() if "embed" not in name)


def test_policies_are_loaded_without_the_libraries_that_train_them():
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == "[]\n"
