"""Released checkpoints by their names: the same numbers as from the released formulae, and every wrong file refused."""

import math
import os
import zipfile

import pytest
import torch

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint
from robogauntlet_mergevla.network.backbone import HiddenStates
from robogauntlet_mergevla.network.config import QWEN, PaperCodeQuirks
from robogauntlet_mergevla.network.lora import BACKBONE
from robogauntlet_mergevla.network.model import empty, trunk
from robogauntlet_mergevla.network.tokenizer import Prompts
from robogauntlet_mergevla.released.files import ReleasedError
from robogauntlet_mergevla.released.importing import (
    architecture_of,
    import_released,
    released_shape,
    save_imported,
    sources_of,
)
from robogauntlet_mergevla.released.names import UNUSED, Kind, released_names, source_of
from tests.errors import one_line_error
from tests.mergevla.network.test_pretrained import LITTLE
from tests.mergevla.released import reference, synthetic

POLICIES = ("mergevla", "vla-adapter")
HEAD = "action_head--50000_checkpoint.pt"


def imported(folder, kind, **changes):
    return import_released(Kind(kind), [synthetic.save(folder / "released", kind, **changes)], size=LITTLE)


def loaded(folder, kind, **changes):
    save_imported(imported(folder, kind, **changes), folder / "checkpoint")
    return load_checkpoint(folder / "checkpoint")


def flat(files):
    """All tensors by the names that the formulae use."""
    return {n.removeprefix("module."): t for tensors in files.values() for n, t in tensors.items()}


def some_inputs(a, batch=2, seed=0):
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(batch, 2, 3, a.image_size, a.image_size, generator=generator)
    ids = torch.randint(0, a.language.vocabulary, (batch, 6), generator=generator)
    return images, ids, torch.rand(batch, 8, generator=generator) * 2 - 1


@pytest.mark.parametrize("kind", POLICIES)
@torch.no_grad()
def test_an_imported_policy_computes_what_the_released_formulae_do(tmp_path, kind):
    weights = flat(synthetic.parts(kind))
    model = loaded(tmp_path, kind).model
    images, ids, proprioception = some_inputs(LITTLE)
    ours = model.hidden_states(images, Prompts(ids, torch.ones_like(ids, dtype=torch.bool)))
    h_t, h_a = reference.hidden_states(weights, LITTLE, images, ids)
    torch.testing.assert_close(torch.stack(ours.task, dim=1), h_t, atol=2e-5, rtol=1e-5)
    torch.testing.assert_close(torch.stack(ours.action, dim=1), h_a, atol=2e-5, rtol=1e-5)
    expected = reference.chunk(weights, LITTLE, h_t, h_a, proprioception, pro=kind == "vla-adapter")
    expected[..., 6] = 1 - 2 * expected[..., 6]
    torch.testing.assert_close(model.act(ours, proprioception), expected, atol=2e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", POLICIES)
@torch.no_grad()
def test_an_imported_block_and_action_expert_equal_the_released_ones(tmp_path, kind):
    weights, pro = flat(synthetic.parts(kind)), kind == "vla-adapter"
    model = loaded(tmp_path, kind).model
    generator = torch.Generator().manual_seed(1)
    x, h_t, h_a = (torch.randn(2, n, LITTLE.width, generator=generator) for n in (8, 5, 4))
    p = torch.randn(2, LITTLE.width, generator=generator)
    ours = model.action_expert.blocks[1](x, torch.cat([h_a, p[:, None]], dim=1), h_t)
    theirs = reference.block(weights, "model.mlp_resnet_blocks.1", x, h_t, h_a, p, LITTLE.expert.heads, pro=pro)
    torch.testing.assert_close(ours, theirs, atol=1e-6, rtol=1e-6)
    h_t, h_a = (torch.randn(2, LITTLE.language.layers + 1, n, LITTLE.width, generator=generator) for n in (8, 4))
    proprioception = torch.rand(2, 8, generator=generator)
    chunk = model.act(HiddenStates(h_t.unbind(1), h_a.unbind(1)), proprioception)
    expected = reference.chunk(weights, LITTLE, h_t, h_a, proprioception, pro=pro)
    expected[..., 6] = 1 - 2 * expected[..., 6]
    torch.testing.assert_close(chunk, expected, atol=2e-6, rtol=1e-6)


@pytest.mark.parametrize("kind", POLICIES)
def test_an_imported_policy_has_the_released_code_s_errors_and_the_statistics_of_its_data(tmp_path, kind):
    metadata = loaded(tmp_path, kind).metadata
    assert metadata.architecture.quirks == PaperCodeQuirks.paper()
    assert metadata.architecture.expert.self_attention is (kind == "vla-adapter")
    assert metadata.architecture.vision.exact_gelu
    assert metadata.tasks == ("libero_spatial_no_noops",)
    assert metadata.statistics.of("libero/any").action.q99 == (0.5,) * 6 + (1.0,)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_weights_keep_their_type_in_which_the_network_then_computes(tmp_path, dtype):
    model = loaded(tmp_path, "mergevla", files=synthetic.parts("mergevla", dtype=dtype)).model
    assert {weight.dtype for weight in model.state_dict().values()} == {dtype}
    images, ids, proprioception = some_inputs(LITTLE)
    chunk = model(images, Prompts(ids, torch.ones_like(ids, dtype=torch.bool)), proprioception)
    assert chunk.dtype == dtype
    assert torch.isfinite(chunk).all()


def test_a_prismatic_model_becomes_a_base_with_a_new_trunk(tmp_path):
    first = imported(tmp_path, "prismatic")
    policy = imported(tmp_path / "policy", "mergevla", files=renamed_backbone())
    assert all(
        torch.equal(tensor, policy.tensors[name]) for name, tensor in first.tensors.items() if name.startswith(BACKBONE)
    )
    assert torch.equal(first.tensors["action_queries"], trunk(first.metadata.architecture, 0)["action_queries"])
    other = import_released(Kind.PRISMATIC, [tmp_path / "released"], seed=1, size=LITTLE)
    assert not torch.equal(first.tensors["action_queries"], other.tensors["action_queries"])
    assert first.metadata.architecture.quirks == PaperCodeQuirks(language_blind=True)


def renamed_backbone():
    """A policy's files with the numbers of the Prismatic model."""
    own = synthetic.parts("prismatic")["latest-checkpoint.pt"]
    files = synthetic.parts("mergevla")
    names = released_names(own)
    files["model.safetensors"] |= {names[name]: tensor for name, tensor in own.items()}
    return files


def test_a_prismatic_model_without_towers_takes_them_from_timm_s_files(tmp_path):
    whole = synthetic.parts("prismatic")["latest-checkpoint.pt"]
    files = {
        "latest-checkpoint.pt": {n: t for n, t in whole.items() if not n.startswith("vision_backbone.")},
        "dinov2.safetensors": {
            n.removeprefix("vision_backbone.dino_featurizer."): t for n, t in whole.items() if ".dino_featurizer." in n
        },
        "siglip.safetensors": {
            n.removeprefix("vision_backbone.siglip_featurizer."): t
            for n, t in whole.items()
            if ".siglip_featurizer." in n
        },
    }
    expected = imported(tmp_path / "whole", "prismatic").tensors
    given = imported(tmp_path / "parts", "prismatic", files=files).tensors
    assert given.keys() == expected.keys()
    assert all(torch.equal(given[name], expected[name]) for name in expected)


def test_positions_of_a_larger_image_make_a_tower_for_it(tmp_path):
    files = synthetic.parts("mergevla")
    files["model.safetensors"]["vision_backbone.featurizer.pos_embed"] = torch.randn(1, 9, LITTLE.vision.dinov2.width)
    model = loaded(tmp_path, "mergevla", files=files).model
    assert model.architecture.vision.dinov2.image_size == 42
    images, ids, _ = some_inputs(LITTLE)
    assert len(model.hidden_states(images, Prompts(ids, torch.ones_like(ids, dtype=torch.bool))).task) == 3


@pytest.mark.parametrize("kind", Kind)
def test_the_large_size_has_the_released_names_and_shapes(kind):
    shapes = synthetic.backbone(QWEN)
    if kind is Kind.PRISMATIC:
        names = released_names(synthetic.prismatic(QWEN))
        shapes = {names[name]: shape for name, shape in synthetic.prismatic(QWEN).items()}
    else:
        head = synthetic.action_head(QWEN, pro=kind is Kind.VLA_ADAPTER)
        for file in (head, synthetic.projector(QWEN), {"action_queries.weight": (64, 896)}):
            names = released_names(file)
            shapes |= {names[name]: shape for name, shape in file.items()}
    positions = {"vision_backbone.featurizer.pos_embed": torch.empty(1, 256, 1024, device="meta")}
    architecture = architecture_of(kind, positions)
    ours = {name: tensor.shape for name, tensor in empty(architecture).state_dict().items()}
    sources = {name: source for name, source in sources_of(kind, architecture).items() if source.name}
    expected = {source.name: tuple(released_shape(ours[name], source.layout)) for name, source in sources.items()}
    assert expected == {name: shape for name, shape in shapes.items() if not UNUSED.match(name)}
    if kind is Kind.MERGEVLA:
        assert sum(math.prod(shape) for name, shape in shapes.items() if name.startswith("action_head")) == 159_996_959


def test_every_weight_of_ours_has_a_source():
    with pytest.raises(KeyError, match="nose"):
        source_of("backbone.nose", Kind.MERGEVLA)


def without(name, count=1):
    files = synthetic.parts("mergevla")
    for tensors in files.values():
        for found in [n for n in tensors if name in n][:count]:
            del tensors[found]
    return files


def with_tensor(file, name, tensor):
    files = synthetic.parts("mergevla")
    files[file][name] = tensor
    return files


GATE = "action_head.model.mlp_resnet_blocks"
WRONG = {
    "one is missing": (
        without("blocks.1.gating_factor"),
        rf"of 'mergevla', of which {GATE}.1.gating_factor is missing; add the files that hold them$",
    ),
    "many are missing": (
        without("blocks.0", 100),
        rf"of which [\d,]+ \({GATE}.0.ffn.0.bias, {GATE}.0.ffn.0.weight, {GATE}.0.ffn.1.bias, ...\) are missing",
    ),
    "one too many": (
        with_tensor("model.safetensors", "nose.weight", torch.ones(2)),
        "tensors of 'mergevla', got nose.weight as well; is it of another kind",
    ),
    "another shape": (
        with_tensor(HEAD, "module.model.fc1.weight", torch.ones(16, 5)),
        r"expected action_head.model.fc1.weight of shape \(16, 112\), as in 'little', got \(16, 5\)$",
    ),
    "another shape of queries, keys and values": (
        with_tensor("model.safetensors", "vision_backbone.featurizer.blocks.0.attn.qkv.bias", torch.ones(16)),
        r"blocks.0.attn.qkv.bias of shape \(48,\), as in 'little', got \(16,\)$",
    ),
    "whole numbers": (
        with_tensor(HEAD, "module.model.fc2.bias", torch.ones(7, dtype=torch.int8)),
        "expected numbers with a fraction in action_head.model.fc2.bias, got torch.int8; quantised",
    ),
    "eight bits": (
        with_tensor("model.safetensors", "projector.fc1.bias", torch.ones(32).to(torch.float8_e4m3fn)),
        "expected numbers with a fraction in projector.fc1.bias, got torch.float8_e4m3fn; quantised",
    ),
    "adapters": (
        with_tensor("model.safetensors", "base_model.model.projector.fc1.lora_A.weight", torch.ones(2, 2)),
        "with their LoRA adapters merged, got projector.fc1.lora_A.weight; merge them first",
    ),
    "a second file of the same": (
        synthetic.parts("mergevla") | {"model-2.safetensors": {"projector.fc1.bias": torch.ones(32)}},
        "expected each tensor once, got projector.fc1.bias in .*; leave one out",
    ),
    "another kind": (
        synthetic.parts("vla-adapter"),
        "tensors of 'mergevla', got those of 'vla-adapter'; import them as that",
    ),
    "positions of no square": (
        with_tensor("model.safetensors", "vision_backbone.featurizer.pos_embed", torch.ones(1, 5, 16)),
        r"pos_embed of shape \(1, 4, 16\), as in 'little', got \(1, 5, 16\)$",
    ),
    "numbers that are none": (
        with_tensor("model.safetensors", "projector.fc1.bias", torch.full((32,), math.nan)),
        "expected finite weights, got NaN or infinity in backbone.projector.0.bias",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_tensors_are_refused_in_one_line_and_nothing_is_written(tmp_path, wrong):
    files, says = WRONG[wrong]
    with one_line_error(Exception, says):
        loaded(tmp_path, "mergevla", files=files)
    assert not (tmp_path / "checkpoint").exists()


STATISTICS = {
    "no statistics": (None, "expected dataset_statistics.json of the data that the policy was trained on"),
    "none": ({}, "expected the statistics of one data set in .*, got none"),
    "two": (
        {**synthetic.STATISTICS, "b": synthetic.STATISTICS["libero_spatial_no_noops"]},
        "of one data set in .*, b$",
    ),
    "no range": ({"a": {"action": {}}}, "got: no 'q01'$"),
    "a number beyond any": (
        {"a": {part: {"q01": [0] * n, "q99": [10**400] * n} for part, n in (("action", 7), ("proprio", 8))}},
        "expected the statistics of a data set",
    ),
    "a list": ([], "expected the statistics of a data set"),
    "fourteen numbers": (
        {"a": {part: {"q01": [0.0] * 14, "q99": [1.0] * 14} for part in ("action", "proprio")}},
        "expected statistics of 7 numbers of action and 8 of proprioception, got of 14 and 14",
    ),
}


@pytest.mark.parametrize("wrong", STATISTICS)
def test_wrong_statistics_are_refused(tmp_path, wrong):
    statistics, says = STATISTICS[wrong]
    with one_line_error(ReleasedError, says):
        imported(tmp_path, "mergevla", statistics=statistics)


class Trap:
    def __reduce__(self):
        return (print, ("code ran",))


def test_a_file_that_would_run_code_is_refused_before_it_does(tmp_path, capsys):
    folder = synthetic.save(tmp_path, "mergevla")
    torch.save({"module.model.fc1.weight": Trap()}, folder / HEAD)
    with one_line_error(ReleasedError, "expected tensors alone in .*: refused, since loading them runs code"):
        import_released(Kind.MERGEVLA, [folder], size=LITTLE)
    assert capsys.readouterr().out == ""


def test_dictionaries_that_refer_to_each_other_are_refused(tmp_path):
    endless, doubled = {}, {"weight": torch.ones(1)}
    endless["again"] = endless
    for _ in range(60):
        doubled = {"a": doubled, "b": doubled}
    for content in (endless, doubled):
        torch.save(content, tmp_path / "model.pt")
        with one_line_error(ReleasedError, "got dictionaries that refer to each other"):
            import_released(Kind.PRISMATIC, [tmp_path / "model.pt"], size=LITTLE)


def test_an_archive_that_unfolds_and_a_pipe_are_refused_before_they_are_read(tmp_path):
    for name, method, content in (
        ("packed", zipfile.ZIP_DEFLATED, bytes(10**6)),
        ("long", zipfile.ZIP_STORED, b"]" * 4_000_001),
    ):
        with zipfile.ZipFile(tmp_path / f"{name}.pt", "w", method) as archive:
            archive.writestr("archive/data.pkl", content)
    os.mkfifo(tmp_path / "pipe.pt")
    os.mkfifo(tmp_path / "pipe.safetensors")
    for name, match in {
        "packed.pt": r"got archive/data\.pkl packed to \d+ bytes",
        "long.pt": "expected at most 4,000,000 bytes of names in .*, got 4,000,001",
        "pipe.pt": "a named pipe, no regular file",
        "pipe.safetensors": "a named pipe, no regular file",
    }.items():
        with one_line_error(PolicyError, match):
            import_released(Kind.PRISMATIC, [tmp_path / name], size=LITTLE)
