"""Runs in an environment with LeRobot: what SmolVLA and pi0.5 download, written small; and pi0.5's class, made small.

LeRobot fixes the widths of pi0.5's two networks in code: three billion numbers. Its class is played with narrower ones:
`language.py CHILD FOLDER DEVICE ...` runs the child process with them.
"""

import json
import runpy
import sys
from types import SimpleNamespace

TOKENIZER = "google/paligemma-3b-pt-224"
"""The tokenizer that LeRobot's pi0.5 names."""
WORDS = ("reach", "Task", "State", "Action", ":", ",", ";", *map(str, range(256)))
SPECIAL = {"unk_token": "<unk>", "pad_token": "<pad>", "bos_token": "<s>", "eos_token": "</s>"}
MORE = {
    "fake_image_token": "<fake_token_around_image>",
    "global_image_token": "<global-img>",
    "image_token": "<image>",
    "end_of_utterance_token": "<end_of_utterance>",
}


def write_tokenizer(folder):
    """Write a tokenizer of whole words, and return it and the size of its vocabulary."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    every = (*SPECIAL.values(), *MORE.values(), *WORDS)
    known = Tokenizer(models.WordLevel({word: place for place, word in enumerate(every)}, unk_token="<unk>"))
    known.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=known, **SPECIAL, extra_special_tokens=MORE)
    tokenizer.save_pretrained(folder)
    return tokenizer, len(every)


def write_vision_language_model(folder):
    """Write the configuration and the processor of a small SmolVLM."""
    from transformers import SmolVLMConfig, SmolVLMImageProcessor, SmolVLMProcessor, SmolVLMVideoProcessor

    tokenizer, size = write_tokenizer(folder)
    text = {"model_type": "llama", "vocab_size": size, "hidden_size": 32, "intermediate_size": 32, "head_dim": 16}
    text |= {"num_hidden_layers": 2, "num_attention_heads": 2, "num_key_value_heads": 1, "pad_token_id": 1}
    vision = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
    vision |= {"image_size": 64, "patch_size": 16}
    SmolVLMConfig(text_config=text, vision_config=vision, scale_factor=2, pad_token_id=1).save_pretrained(folder)
    parts = (SmolVLMImageProcessor(), tokenizer, SmolVLMVideoProcessor())
    SmolVLMProcessor(*parts, chat_template="{{ messages }}").save_pretrained(folder)


def make_pi05_small():
    """Let LeRobot's pi0.5 have narrow networks in this process."""
    from lerobot.policies.pi05 import modeling_pi05 as code

    def narrow(original):
        def made(config):
            text, vision = getattr(config, "text_config", config), getattr(config, "vision_config", SimpleNamespace())
            text.vocab_size = config._vocab_size = 300
            vision.hidden_size, vision.intermediate_size, vision.projection_dim = 16, 16, text.hidden_size
            vision.num_hidden_layers, vision.num_attention_heads = 1, 2
            return original(config)

        return made

    for name in ("PaliGemmaForConditionalGenerationWithPiGemma", "PiGemmaForCausalLM"):
        setattr(code, name, narrow(getattr(code, name)))
    widths = {"width": 32, "depth": 2, "mlp_dim": 32, "num_heads": 2, "num_kv_heads": 1, "head_dim": 16}
    code.get_gemma_config = lambda variant: code.GemmaConfig(**widths)


def name_tokenizer(checkpoint, tokenizer):
    """Let a checkpoint's preprocessing take its tokenizer from a folder."""
    file = checkpoint / "policy_preprocessor.json"
    described = json.loads(file.read_text())
    for step in described["steps"]:
        if "tokenizer_name" in step["config"]:
            step["config"]["tokenizer_name"] = str(tokenizer)
    file.write_text(json.dumps(described))


if __name__ == "__main__":
    make_pi05_small()
    del sys.argv[0]
    runpy.run_path(sys.argv[0], run_name="__main__")
