"""The network: the paper's sizes, the inputs of each part, and the effect of each quirk."""

from dataclasses import fields, replace

import pytest
import torch
from hypothesis import given, settings, strategies as st

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.network.action_expert import Block, rotate
from robogauntlet_mergevla.network.config import QWEN, TINY, ExpertConfig, LanguageModel, PaperCodeQuirks
from robogauntlet_mergevla.network.model import MergeVLA, build, count
from robogauntlet_mergevla.network.tokenizer import Prompts, tokenizer_for
from tests.mergevla.shared import SMALL, inputs, small_model, with_quirk


@pytest.fixture(scope="module")
def qwen():
    with torch.device("meta"):
        return MergeVLA(QWEN)


def test_the_large_size_has_the_papers_counts(qwen):
    expert, backbone = qwen.action_expert, qwen.backbone
    assert [count(block) for block in expert.blocks] == [6_431_489] * 24
    assert count(expert) == 159_996_959
    assert count(backbone.language) == 494_032_768
    assert count(backbone.projector) == 27_552_000
    assert count(qwen.proprioception) == 811_776
    assert tuple(qwen.action_queries.shape) == (64, 896)
    assert count(backbone.language, backbone.projector, expert) / 1e9 == pytest.approx(0.6815, abs=1e-4)


def test_the_large_size_computes_chunks_of_the_right_shape(qwen):
    images, prompts, proprioception = inputs(replace(QWEN, tokenizer="words"), batch=2)
    on_meta = Prompts(prompts.ids.to("meta"), prompts.present.to("meta"))
    hidden = qwen.hidden_states(images.to("meta"), on_meta)
    assert [tuple(h.shape) for h in hidden.task] == [(2, 512, 896)] * 25
    assert [tuple(h.shape) for h in hidden.action] == [(2, 64, 896)] * 25
    assert qwen.act(hidden, proprioception.to("meta")).shape == (2, 8, 7)


def test_the_tiny_size_is_tiny():
    assert 1_000_000 < count(build(TINY, 0)) < 2_000_000


def test_hidden_states_and_expert_make_up_the_forward_pass():
    model = small_model()
    images, prompts, proprioception = inputs(SMALL)
    hidden = model.hidden_states(images, prompts)
    assert len(hidden.task) == len(hidden.action) == SMALL.language.layers + 1
    assert torch.equal(model.act(hidden, proprioception), model(images, prompts, proprioception))


def test_actions_depend_on_proprioception():
    model = small_model()
    images, prompts, proprioception = inputs(SMALL)
    assert not torch.allclose(model(images, prompts, -proprioception), model(images, prompts, proprioception))


def test_the_last_hidden_states_alone_went_through_the_final_norm():
    model = small_model()
    torch.nn.init.zeros_(model.backbone.language.norm.weight)
    hidden = model.hidden_states(*inputs(SMALL)[:2])
    assert [bool(states.any()) for states in hidden.action] == [True] * SMALL.language.layers + [False]


def test_equal_seeds_give_equal_weights_and_keep_the_global_generator():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    one, two, other = build(SMALL, 1), build(SMALL, 1), build(SMALL, 2)
    assert torch.equal(torch.rand(1), expected)
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), two.parameters(), strict=True))
    assert not torch.equal(one.action_queries, other.action_queries)


@pytest.mark.parametrize("bidirectional", [False, True])
@pytest.mark.parametrize("quirk", [None, *(quirk.name for quirk in fields(PaperCodeQuirks))])
def test_an_answer_does_not_depend_on_the_rest_of_its_batch_nor_on_padding(quirk, bidirectional):
    language = replace(SMALL.language, bidirectional=bidirectional)
    model = small_model(language=language, **(with_quirk(quirk) if quirk else {}))
    wider = small_model(language=language, prompt_tokens=12, **(with_quirk(quirk) if quirk else {}))
    wider.load_state_dict(model.state_dict())
    images, prompts, proprioception = inputs(SMALL)
    together = model(images, prompts, proprioception)
    padded = wider(images, inputs(wider.architecture)[1], proprioception)
    torch.testing.assert_close(padded, together, atol=1e-5, rtol=0)
    for i in range(len(images)):
        row = slice(i, i + 1)
        alone = model(images[row], Prompts(prompts.ids[row], prompts.present[row]), proprioception[row])
        torch.testing.assert_close(alone, together[row], atol=1e-5, rtol=0)


@pytest.mark.parametrize("blind", [False, True])
def test_patches_see_the_instruction_unless_it_is_hidden(blind):
    model = small_model(quirks=PaperCodeQuirks(language_blind=blind))
    images = inputs(SMALL, batch=1)[0]
    push, pull = (model.hidden_states(images, tokenizer_for(SMALL)([words])) for words in ("push it", "pull it"))
    assert torch.equal(push.task[-1], pull.task[-1]) is blind
    assert not torch.equal(push.action[-1], pull.action[-1])


def test_shifted_slices_start_one_position_too_early():
    images, prompts, _ = inputs(SMALL)
    right, shifted = (
        small_model(quirks=PaperCodeQuirks(language_blind=True, shifted_slices=s)).hidden_states(images, prompts)
        for s in (False, True)
    )
    assert torch.equal(shifted.task[-1][:, 1:], right.task[-1][:, :-1])
    assert torch.equal(shifted.action[-1][:, 1:], right.action[-1][:, :-1])


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_rope_is_a_rotation_and_depends_on_distances_only(seed):
    generator = torch.Generator().manual_seed(seed)
    q, k = (torch.randn(1, 8, generator=generator).expand(12, 8) for _ in range(2))
    torch.testing.assert_close(rotate(q).norm(dim=-1), q.norm(dim=-1), atol=1e-5, rtol=0)
    products = rotate(q) @ rotate(k).T
    torch.testing.assert_close(products[0, 2], products[5, 7], atol=1e-4, rtol=0)


def test_the_papers_rope_is_no_rotation():
    q = torch.randn(12, 8, generator=torch.Generator().manual_seed(0))
    assert not torch.allclose(rotate(q, interleaved=True).norm(dim=-1), q.norm(dim=-1), atol=1e-2)


def test_without_skip_a_blocks_tokens_are_the_feed_forwards_output():
    tokens, keys = torch.randn(2, 8, 16), torch.randn(2, 4, 16)
    assert (Block(replace(SMALL, quirks=PaperCodeQuirks(ffn_without_skip=True)))(tokens, keys, keys) >= 0).all()
    assert (Block(SMALL)(tokens, keys, keys) < 0).any()


def test_training_noise_is_added_in_training_only():
    noisy, quiet = small_model(**with_quirk("training_noise")), small_model()
    batch = inputs(SMALL)
    assert not torch.equal(noisy.train()(*batch), noisy(*batch))
    assert torch.equal(noisy.eval()(*batch), noisy(*batch))
    assert torch.equal(quiet.train()(*batch), quiet(*batch))


def test_only_self_attention_connects_a_chunks_steps():
    for variant in (False, True):
        block = Block(replace(SMALL, expert=ExpertConfig(heads=2, self_attention=variant)))
        tokens, keys = torch.randn(1, 8, 16), torch.randn(1, 4, 16)
        changed = tokens.clone()
        changed[:, 0] += 1.0
        assert torch.equal(block(tokens, keys, keys)[:, 1:], block(changed, keys, keys)[:, 1:]) is not variant


def test_a_closed_gate_hides_the_differences_among_task_states():
    block = Block(SMALL)
    tokens, keys, task = torch.randn(1, 8, 16), torch.randn(1, 4, 16), torch.randn(1, 5, 16)
    with torch.no_grad():
        block.gate.fill_(-100.0)
        block.v_task.weight.zero_()
    torch.testing.assert_close(block(tokens, keys, task), block(tokens, keys, task.roll(1) * 3), atol=1e-6, rtol=0)


def test_the_gate_is_a_sigmoid_unless_it_is_vla_adapters():
    assert not ExpertConfig(4).gates_by_tanh
    assert ExpertConfig(4, self_attention=True).gates_by_tanh
    assert not ExpertConfig(4, self_attention=True, tanh_gate=False).gates_by_tanh
    assert ExpertConfig(4, tanh_gate=True).gates_by_tanh


def test_inputs_of_another_shape_are_refused():
    model = small_model()
    images, prompts, proprioception = inputs(SMALL)
    with pytest.raises(PolicyError, match=r"images of shape \(B, 2, 3, 16, 16\), got \(4, 1, 3, 16, 16\)"):
        model(images[:, :1], prompts, proprioception)
    with pytest.raises(PolicyError, match=r"proprioception of shape \(B, 8\), got \(4, 7\)"):
        model(images, prompts, proprioception[:, :7])


@pytest.mark.nightly
def test_the_tiny_size_can_memorise_eight_samples():
    torch.set_num_threads(1)
    model, steps = build(TINY, 0).train(), 80
    batch = inputs(TINY, batch=8)
    start, way = (torch.rand(2, 8, 1, 7, generator=torch.Generator().manual_seed(1)) * 2 - 1).unbind()
    chunks = (start + way * torch.linspace(0, 1, 8)[:, None]).clamp(-1, 1)
    optimiser = torch.optim.AdamW(model.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=steps, pct_start=0.1)
    for _ in range(steps):
        loss = (model(*batch) - chunks).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    with torch.inference_mode():
        assert (model.eval()(*batch) - chunks).abs().mean() < 0.05


def test_grouped_keys_and_the_language_model_of_both_sizes_are_one_class():
    grouped = small_model(language=LanguageModel(16, 2, 4, 2, 32, 64))
    assert type(grouped.backbone.language) is type(build(TINY, 0).backbone.language)
    assert grouped(*inputs(grouped.architecture)).shape == (4, 8, 7)
