"""Loading pretrained weights, with small random towers and a small random decoder."""

from dataclasses import replace

import pytest
import torch
from tokenizers import Tokenizer, models, pre_tokenizers

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.network.backbone import Backbone, Pretrained, load_pretrained
from robogauntlet_mergevla.network.config import QWEN, ExpertConfig, LanguageModel, LoraSettings, Tower, Towers
from robogauntlet_mergevla.network.lora import add_lora
from robogauntlet_mergevla.network.model import build
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from tests.errors import one_line_error
from tests.mergevla.network.test_decoder import qwen
from tests.mergevla.shared import inputs

LITTLE = replace(
    QWEN,
    name="little",
    image_size=28,
    vision=Towers(Tower(16, 3, 2, 32, 14, 42), Tower(24, 3, 2, 40, 14, 28)),
    projector=(32, 16),
    language=LanguageModel(16, layers=2, heads=2, key_value_heads=1, feed_forward=32, vocabulary=64),
    action_queries=4,
    expert=ExpertConfig(heads=2),
    tokenizer="words",
)
TEMPLATE = "{% for m in messages %}<s> {{ m['role'] }} {{ m['content'] }} {% endfor %}"


@pytest.fixture
def source(tmp_path):
    """Folders of pretrained weights, and the backbone that they were saved from."""
    original = build(LITTLE, seed=1).backbone
    places = Pretrained(*(str(tmp_path / name) for name in ("language", "dinov2", "siglip")))
    language = qwen(LITTLE.language)
    language.load_state_dict(original.language.state_dict())
    language.save_pretrained(places.language)
    original.vision.dinov2.save_pretrained(places.dinov2)
    original.vision.siglip.save_pretrained(places.siglip)
    return places, original


def test_pretrained_weights_are_loaded_from_folders(source):
    places, original = source
    model = build(LITTLE, seed=2)
    model.backbone.projector.load_state_dict(original.projector.state_dict())
    load_pretrained(model.backbone, places)
    images, prompts, proprioception = inputs(LITTLE)
    expected = original(images, prompts, model.action_queries)
    assert torch.equal(model.hidden_states(images, prompts).action[-1], expected.action[-1])
    assert model(images, prompts, proprioception).shape == (4, 8, 7)


def test_the_last_block_of_a_tower_is_not_read():
    model = build(LITTLE, seed=1).eval()
    images = inputs(LITTLE)[0]
    before = model.backbone.vision(images)
    with torch.no_grad():
        model.backbone.vision.siglip.encoder.layers[-1].mlp.fc1.weight.zero_()
        model.backbone.vision.dinov2.encoder.layer[-1].mlp.fc1.weight.zero_()
    assert torch.equal(model.backbone.vision(images), before)
    assert before.shape == (4, LITTLE.patches, 40)


def test_adapters_reach_both_towers_the_projector_and_the_decoder():
    model = build(LITTLE, seed=1)
    add_lora(model, LoraSettings(rank=2), seed=0)
    parts = {".".join(name.split(".")[1:3]) for name, _ in model.named_parameters() if ".lora_A." in name}
    assert {"vision.dinov2", "vision.siglip", "projector.0", "language.layers"} <= parts


def test_weights_of_another_architecture_are_refused(source):
    wider = replace(LITTLE, language=replace(LITTLE.language, feed_forward=48))
    message = r"expected layers.0.mlp.gate_proj.weight of shape \(48, 16\), got \(32, 16\)"
    with pytest.raises(PolicyError, match=message):
        load_pretrained(Backbone(wider), source[0])


def test_missing_weights_are_refused_in_one_line(source, tmp_path):
    with one_line_error(PolicyError, "expected pretrained safetensors at"):
        load_pretrained(Backbone(LITTLE), replace(source[0], siglip=str(tmp_path)))


def test_a_chat_prompt_asks_for_the_action_by_the_tokenizers_own_template(tmp_path):
    words = ["<unk>", "<s>", "system", "user", "what", "action", "push", "the", "cube", "?", "to", "take", "robot"]
    plain = Tokenizer(models.WordLevel({word: i for i, word in enumerate(words)}, unk_token="<unk>"))
    plain.pre_tokenizer = pre_tokenizers.Split(" ", "removed")
    from transformers import PreTrainedTokenizerFast  # seconds that each process of the tests would spend

    saved = PreTrainedTokenizerFast(tokenizer_object=plain, unk_token="<unk>")
    saved.chat_template = TEMPLATE
    saved.save_pretrained(tmp_path)
    prompts = tokenizer_for(replace(LITTLE, tokenizer=str(tmp_path)))(["Push the cube now", "reach"])
    ids = prompts.ids[0][prompts.present[0]].tolist()
    assert ids[0] == words.index("<s>")
    assert ids.count(words.index("user")) == 1
    assert [words.index(word) for word in ("push", "the", "cube")] == ids[-4:-1]
    assert prompts.present.sum(1).tolist() == [27, 24]
