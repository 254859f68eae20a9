"""Architectures of MergeVLA networks (arXiv 2511.18810). Frozen values; no torch."""

from __future__ import annotations

from dataclasses import field, fields, replace
from typing import Annotated, ClassVar, Literal

from pydantic import Field, StrictInt
from pydantic.dataclasses import dataclass

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM
from robogauntlet.policies.stored import STRICT, Stored, StoredError
from robogauntlet.suites.episode import CAMERAS

Size = Annotated[int, Field(ge=1, le=10_000_000)]
"""A number of things in a network; far above what any has."""
Layers = Annotated[int, Field(ge=1, le=1_000)]
Pixels = Annotated[int, Field(ge=1, le=8_192)]
Widths = Annotated[tuple[Size, ...], Field(max_length=100)]


class ArchitectureError(StoredError):
    """An architecture that cannot be built."""


@dataclass(frozen=True, config=STRICT)
class ConvStem:
    """A stack of convolutions per camera, each halving the image; every cell of the last map is a patch."""

    channels: Annotated[tuple[Size, ...], Field(max_length=12)] = (16, 32, 64, 128)
    groups: Size = 4
    """Groups of channels that are normalised together after each convolution (arXiv 1803.08494). Without them, training
    from scratch is slower: a held-out L1 of .122 instead of .103 after 450 steps on PandaPickAndPlace."""
    kind: Literal["ConvStem"] = "ConvStem"

    def __post_init__(self) -> None:
        if not self.channels or self.groups < 1 or any(width % self.groups for width in self.channels):
            raise ArchitectureError(f"expected channels in {self.groups} equal groups, got {self.channels}")

    @property
    def width(self) -> int:
        """Numbers per patch."""
        return self.channels[-1]

    def patches(self, image_size: int) -> int:
        """Patches per image."""
        side = image_size
        for _ in self.channels:
            side = (side + 1) // 2
        return side * side


@dataclass(frozen=True, config=STRICT)
class Tower:
    """A vision transformer."""

    width: Size
    layers: Layers
    heads: Size
    feed_forward: Size
    patch_size: Size
    image_size: Pixels
    """Height and width (px) of the images that its position embeddings were made for."""


@dataclass(frozen=True, config=STRICT)
class Towers:
    """DINOv2 (with four registers) beside SigLIP; the features of each one's second-to-last block, concatenated."""

    dinov2: Tower = Tower(width=1024, layers=24, heads=16, feed_forward=4096, patch_size=14, image_size=518)
    siglip: Tower = Tower(width=1152, layers=27, heads=16, feed_forward=4304, patch_size=14, image_size=224)
    exact_gelu: bool = False
    """SigLIP's GELU without the approximation by tanh that Hugging Face's has, as in timm and thus in Prismatic."""
    kind: Literal["Towers"] = "Towers"

    @property
    def width(self) -> int:
        """Numbers per patch."""
        return self.dinov2.width + self.siglip.width

    def patches(self, image_size: int) -> int:
        """Patches per image."""
        return (image_size // self.siglip.patch_size) ** 2


@dataclass(frozen=True, config=STRICT)
class LanguageModel:
    """Sizes of a Qwen2 decoder."""

    width: Size
    layers: Layers
    heads: Size
    key_value_heads: Size
    feed_forward: Size
    vocabulary: Size
    rope_theta: float = 1e6
    bidirectional: bool = False
    """Attend to the whole sequence, not only to earlier tokens. For decoders that are trained from scratch; a
    pretrained one was trained with causal attention."""


@dataclass(frozen=True, config=STRICT)
class ExpertConfig:
    """The cross-attention stack that turns hidden states into actions, with one block for each decoder layer."""

    heads: Size
    self_attention: bool = False
    """VLA-Adapter's block, which the paper compares with: the chunk's steps attend to each other too, one query
    projection serves all keys, and the gate is a tanh."""
    tanh_gate: bool | None = None
    """Gate by tanh instead of sigmoid; None for the variant's own, so that each change can be studied separately."""

    @property
    def gates_by_tanh(self) -> bool:
        """Whether the gate is a tanh."""
        return self.self_attention if self.tanh_gate is None else self.tanh_gate


@dataclass(frozen=True, config=STRICT)
class PaperCodeQuirks:
    """Errors of the paper's released code, each with its own switch. All False is the repaired network."""

    interleaved_rope: bool = False
    """Combine neighbouring pairs with angles laid out for half-split pairs, which is not a rotation."""
    ffn_without_skip: bool = False
    """No skip connection around a block's feed-forward layer."""
    training_noise: bool = False
    """Initial action tokens are zeros, with N(0, 0.02) noise in training only, instead of a step encoding."""
    shifted_slices: bool = False
    """Take the hidden states of patches and action queries one position too early."""
    language_blind: bool = False
    """Put the instruction after the images under causal attention, so that no patch attends to it."""

    @classmethod
    def paper(cls) -> PaperCodeQuirks:
        """Return the network as released, with all of them."""
        return cls(**{quirk.name: True for quirk in fields(cls)})


@dataclass(frozen=True, config=STRICT)
class Architecture(Stored):
    """One MergeVLA network."""

    what: ClassVar = "architecture"
    refusal: ClassVar = ArchitectureError

    name: str
    image_size: Pixels
    """Height and width (px) of each camera's image."""
    vision: Annotated[ConvStem | Towers, Field(discriminator="kind")]
    projector: Widths
    """Widths of the layers between the vision features and the language model's own width."""
    language: LanguageModel
    action_queries: Size
    expert: ExpertConfig
    tokenizer: str
    """`words` for hashed words, else what `transformers.AutoTokenizer` can load: a folder or a hub id."""
    prompt_tokens: Size
    """Length to which shorter prompts are padded."""
    cameras: tuple[str, ...] = CAMERAS
    chunk_length: Size = 8
    action_dim: Size = ACTION_DIM
    proprioception_dim: Size = PROPRIOCEPTION_DIM
    quirks: PaperCodeQuirks = field(default_factory=PaperCodeQuirks)

    def __post_init__(self) -> None:
        width, expert, language = self.language.width, self.expert.heads, self.language.heads
        if width % (2 * expert) or width % (2 * language):
            raise ArchitectureError(
                f"architecture '{self.name}': expected heads of even width, got width {width} in {language} heads "
                f"(language model) and {expert} (action expert)"
            )
        if not self.cameras or self.prompt_tokens < 2 or self.action_queries < 1:
            raise ArchitectureError(
                f"architecture '{self.name}': expected a camera, 2 prompt tokens and an action query at least, "
                f"got {len(self.cameras)}, {self.prompt_tokens} and {self.action_queries}"
            )

    def with_numbers(self, action_dim: int, proprioception_dim: int) -> Architecture:
        """Return the same network for actions and proprioception of these sizes."""
        return replace(self, action_dim=action_dim, proprioception_dim=proprioception_dim)

    @property
    def width(self) -> int:
        """Numbers per token, in the language model and in the action expert."""
        return self.language.width

    @property
    def patches(self) -> int:
        """Patches of all cameras."""
        return len(self.cameras) * self.vision.patches(self.image_size)


@dataclass(frozen=True, config=STRICT)
class LoraSettings(Stored):
    """The backbone's adapters."""

    what: ClassVar = "LoRA settings"
    refusal: ClassVar = ArchitectureError

    rank: StrictInt = 32
    convolutions: bool = False
    """Adapt convolutions in addition to linear layers."""

    def __post_init__(self) -> None:
        if self.rank < 1:
            raise ArchitectureError(f"expected a LoRA rank of 1 or more, got {self.rank}")

    @property
    def alpha(self) -> int:
        """Twice the rank, so that B A is scaled by 2."""
        return 2 * self.rank


TINY = Architecture(
    name="tiny",
    image_size=96,
    vision=ConvStem((16, 32, 64, 96, 128)),
    projector=(256,),
    language=LanguageModel(
        width=128, layers=4, heads=4, key_value_heads=4, feed_forward=256, vocabulary=1280, bidirectional=True
    ),
    action_queries=8,
    expert=ExpertConfig(heads=4),
    tokenizer="words",
    prompt_tokens=16,
)
"""Trained from scratch on a CPU: 1.94 M parameters. Five strides leave 9 patches per camera: with 36, a training step
takes twice as long."""

QWEN = Architecture(
    name="qwen2.5-0.5b",
    image_size=224,
    vision=Towers(),
    projector=(8704, 896),
    language=LanguageModel(width=896, layers=24, heads=14, key_value_heads=2, feed_forward=4864, vocabulary=151936),
    action_queries=64,
    expert=ExpertConfig(heads=8),
    tokenizer="Qwen/Qwen2.5-0.5B",
    prompt_tokens=64,
)
"""The paper's architecture: Qwen2.5-0.5B with DINOv2-L/14-reg4 and SigLIP-so400m/14."""

SIZES = {architecture.name: architecture for architecture in (TINY, QWEN)}
"""Architectures by name."""

CONTROLS = {
    "tiny-tanh": replace(TINY, expert=ExpertConfig(heads=4, tanh_gate=True)),
    "tiny-self-attention": replace(TINY, expert=ExpertConfig(heads=4, self_attention=True)),
    "tiny-quirks": replace(TINY, quirks=PaperCodeQuirks.paper()),
    "tiny-self-attention-sigmoid": replace(TINY, expert=ExpertConfig(heads=4, self_attention=True, tanh_gate=False)),
}
"""Networks of `studies/merging/training_controls.sh`: other action experts, and the errors of the released code."""
