"""Architectures: JSON, quirks and invalid values."""

from dataclasses import asdict, replace

import pytest

from robogauntlet_mergevla.network.config import (
    CONTROLS,
    QWEN,
    SIZES,
    TINY,
    Architecture,
    ArchitectureError,
    ExpertConfig,
    LoraSettings,
    PaperCodeQuirks,
)


@pytest.mark.parametrize("architecture", [*SIZES.values(), replace(TINY, quirks=PaperCodeQuirks.paper())])
def test_an_architecture_is_read_back_from_json(architecture):
    assert Architecture.from_json(architecture.as_json()) == architecture


def test_the_repaired_network_is_the_default_and_the_paper_has_every_quirk():
    assert TINY.quirks == QWEN.quirks
    assert not any(asdict(TINY.quirks).values())
    assert all(asdict(PaperCodeQuirks.paper()).values())


def test_both_sizes_count_their_patches():
    assert (TINY.patches, QWEN.patches) == (18, 512)


@pytest.mark.parametrize("spoil", [{"vision": {"kind": "Resnet"}}, {"language": None}, {"colour": "red"}])
def test_a_malformed_architecture_is_refused(spoil):
    with pytest.raises(ArchitectureError, match=r"architecture: (vision|language|colour): "):
        Architecture.from_json({**TINY.as_json(), **spoil})


def test_heads_of_odd_width_are_refused():
    with pytest.raises(ArchitectureError, match="heads of even width"):
        replace(TINY, expert=ExpertConfig(heads=3))


@pytest.mark.parametrize("rank", [0, -4, 2.5, True])
def test_a_rank_out_of_range_is_refused(rank):
    with pytest.raises(ArchitectureError, match=rf"expected .*, got {rank}$"):
        LoraSettings.from_json({"rank": rank})
    with pytest.raises(ArchitectureError, match="expected a LoRA rank of 1 or more, got 0"):
        LoraSettings(0)


def test_the_controls_differ_from_the_tiny_network_in_their_action_experts_or_in_the_released_codes_errors():
    blocks = dict(CONTROLS)
    assert blocks.pop("tiny-quirks") == replace(TINY, quirks=PaperCodeQuirks.paper())
    assert all(replace(control, expert=TINY.expert) == TINY for control in blocks.values())
    variants = {name: (control.expert.self_attention, control.expert.gates_by_tanh) for name, control in blocks.items()}
    assert variants == {
        "tiny-tanh": (False, True),
        "tiny-self-attention": (True, True),
        "tiny-self-attention-sigmoid": (True, False),
    }
