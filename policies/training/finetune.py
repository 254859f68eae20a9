"""Trains MergeVLA: a base on the pooled demonstrations of all tasks, then one expert per task from it.

The loss is the mean L1 over the normalised action chunk (arXiv 2511.18810), past the episode's end left out. The paper
starts from a pretrained vision-language model and draws each expert's trunk anew; here the base holds the trunk too, so
that experts share their initialisation and task vectors are defined for all of it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from policies.mergevla.card import CARD, Card, check_action_steps
from policies.mergevla.checkpoint import load_checkpoint, save_checkpoint
from policies.mergevla.config import Architecture, LoraSettings
from policies.mergevla.lora import add_lora
from policies.mergevla.model import MergeVLA, build
from policies.mergevla.tokens import tokenizer_for
from policies.training.pool import Pool
from policies.training.reading import Reader
from policies.training.schedule import Schedule, rate_at
from policies.training.state import STATE_FILE, History, TrainingError, load_state, save_state
from suites.vocabulary import content_hash

CURVE_FILE = "losses.json"
RECENT = 50
"""Steps over which the training loss is averaged for show."""
LARGEST_SEED = 2**63 - 1
WARMING_S = 1.0
"""Before this much time, nothing is said about the pace."""


@dataclass(frozen=True)
class Settings:
    """How to train. Everything here but `save_s` and `threads` decides the weights."""

    steps: int = 2000
    batch_size: int = 32
    learning_rate: float = 1e-3
    warm_up: int = 50
    """Steps in which the learning rate rises."""
    schedule: Schedule = Schedule.COSINE
    weight_decay: float = 0.01
    clip: float = 1.0
    """Largest norm of the gradient."""
    largest_shift: int = 4
    """Augmentation: images move by up to so many px."""
    seed: int = 0
    evaluate_every: int = 250
    """Steps between looks at the held-out episodes."""
    save_s: float = 60.0
    """Seconds between two writings of the state file."""
    threads: int = 1

    def __post_init__(self) -> None:
        for name, least in (("steps", 1), ("batch_size", 1), ("evaluate_every", 1), ("threads", 1), ("warm_up", 0)):
            if getattr(self, name) < least:
                raise TrainingError(f"expected {name.replace('_', ' ')} of {least} or more, got {getattr(self, name)}")
        if not 0.0 < self.learning_rate < 1.0:
            raise TrainingError(f"expected a learning rate between 0 and 1, got {self.learning_rate}")
        if self.largest_shift < 0 or not 0 <= self.seed <= LARGEST_SEED or self.clip <= 0.0:
            raise TrainingError(
                f"expected a shift of 0 or more, a seed of 0 to 2^63 - 1 and a clip above 0, "
                f"got {self.largest_shift}, {self.seed} and {self.clip}"
            )

    @property
    def decisive(self) -> dict[str, object]:
        """What decides the weights, as plain JSON."""
        return {name: value for name, value in asdict(self).items() if name not in ("save_s", "threads")}


@dataclass(frozen=True)
class Pace:
    """How a training goes."""

    step: int
    """Steps taken."""
    steps: int
    loss: float
    """Mean over the last steps."""
    held_out: float | None
    """L1 on held-out episodes when they were last looked at, if there are any."""
    steps_per_s: float | None
    left_s: float | None


@dataclass(frozen=True)
class Trained:
    """What came of a training."""

    card: Card | None
    """The checkpoint's, or None if the training was stopped before its end."""
    history: History


Listener = Callable[[Pace], None]
"""Told after every step."""
Stop = Callable[[], bool]
"""Asked after every step whether to stop; the state is saved then."""


def pretrain(
    pool: Pool,
    architecture: Architecture,
    out: Path,
    settings: Settings,
    *,
    action_steps: int | None = None,
    prepare: Callable[[MergeVLA], None] | None = None,
    listener: Listener | None = None,
    stop: Stop | None = None,
) -> Trained:
    """Train the base that experts start from, all its weights, and save it to `out`.

    Args:
        pool: Demonstrations of all tasks, each normalised by its own statistics: else the task with the widest motions
            would decide the loss.
        architecture: Of the network.
        out: Folder of the checkpoint. A training that was stopped there is continued.
        settings: How to train.
        action_steps: See `Card.action_steps`; it decides nothing about the training.
        prepare: Loads pretrained weights into the new network.
        listener: See `Listener`.
        stop: See `Stop`.

    Raises:
        PolicyError: Data of other images than the architecture's, or a folder that holds something else.
    """
    check_action_steps(action_steps, architecture)
    check_images(pool, architecture)
    model = build(architecture, settings.seed)
    if prepare is not None:
        prepare(model)
    card = Card(architecture, pool.statistics, action_steps=action_steps, data_hash=pool.data_hash)
    return _train(model, card, None, pool, out, settings, listener, stop)


def finetune(
    pool: Pool,
    base: str | Path,
    out: Path,
    settings: Settings,
    *,
    lora: LoraSettings,
    action_steps: int | None = None,
    listener: Listener | None = None,
    stop: Stop | None = None,
) -> Trained:
    """Train an expert from a base: adapters on the backbone, all of the rest; save it to `out`.

    Args:
        pool: Demonstrations of the expert's task; its own statistics normalise, as in the paper.
        base: The base's folder or hub id; it must stay where it is.
        out: Folder of the checkpoint. A training that was stopped there is continued.
        settings: How to train.
        lora: The adapters.
        action_steps: See `Card.action_steps`; it decides nothing about the training.
        listener: See `Listener`.
        stop: See `Stop`.

    Raises:
        PolicyError: A base that is none, data of other images than its own, or a folder that holds something else.
    """
    start = load_checkpoint(base)
    if start.card.base is not None or start.card.lora is not None:
        raise TrainingError(f"expected a base that stands alone, got '{base}', an expert")
    if isinstance(base, Path) and base.resolve() == out.resolve():
        raise TrainingError(f"expected another folder than the base's for the expert, got '{out}'")
    check_images(pool, start.model.architecture)
    check_action_steps(action_steps, start.model.architecture)
    add_lora(start.model, lora, settings.seed)
    card = Card(
        start.model.architecture,
        pool.statistics,
        action_steps=action_steps,
        lora=lora,
        data_hash=pool.data_hash,
        base_hash=start.card.tensor_hash,
    )
    return _train(start.model, card, base, pool, out, settings, listener, stop)


def check_images(pool: Pool, architecture: Architecture) -> None:
    """Refuse data whose images are not what the network sees.

    Raises:
        TrainingError: With what was expected and what came.
    """
    missing = [camera for camera in architecture.cameras if camera not in pool.cameras]
    if missing:
        raise TrainingError(f"expected images of camera {missing[0]}, the data has {', '.join(pool.cameras)}")
    if pool.image_size != architecture.image_size:
        raise TrainingError(
            f"expected {architecture.image_size} px images for architecture '{architecture.name}', "
            f"the data has {pool.image_size} px"
        )


def _train(
    model: MergeVLA,
    card: Card,
    base: str | Path | None,
    pool: Pool,
    out: Path,
    settings: Settings,
    listener: Listener | None,
    stop: Stop | None,
) -> Trained:
    if (out / CARD).exists():
        raise TrainingError(f"expected a folder without a checkpoint, '{out}' holds a finished one")
    torch.set_num_threads(settings.threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = model.to(device).train()
    reader = Reader(model.architecture, card.statistics, tokenizer_for(model.architecture), device)
    weights = {name: weight for name, weight in model.named_parameters() if weight.requires_grad}
    optimiser = torch.optim.AdamW(
        weights.values(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    # Batches are drawn from episodes in their order, which the data's hash does not say.
    order = [dataset.episode_hashes for dataset in pool.datasets]
    identity = content_hash({"card": card.as_json(), "settings": settings.decisive, "order": order})
    history = load_state(out / STATE_FILE, weights, optimiser, identity) or History(identity)
    began, before, saved = time.monotonic(), history.step, time.monotonic()
    seconds_before = history.seconds
    while history.step < settings.steps:
        history.losses.append(_step(model, reader, pool, weights, optimiser, settings, history.step))
        history.step += 1
        if history.step % settings.evaluate_every == 0 or history.step == settings.steps:
            _look_at_held_out(model, reader, pool, settings, history)
        now = time.monotonic()
        history.seconds = seconds_before + now - began
        if listener is not None:
            listener(_pace(history, settings, history.step - before, now - began))
        stopping = stop is not None and stop() and history.step < settings.steps
        if stopping or now - saved >= settings.save_s:
            save_state(out / STATE_FILE, weights, optimiser, history)
            saved = now
        if stopping:
            return Trained(None, history)
    written = save_checkpoint(out, model, replace(card, metrics=_metrics(settings, pool, history)), base)
    curve = {"train": [round(loss, 5) for loss in history.losses], "held_out": history.held_out}
    (out / CURVE_FILE).write_text(json.dumps(curve) + "\n", encoding="utf-8")
    (out / STATE_FILE).unlink(missing_ok=True)
    return Trained(written, history)


def _step(
    model: MergeVLA,
    reader: Reader,
    pool: Pool,
    weights: dict[str, nn.Parameter],
    optimiser: torch.optim.AdamW,
    settings: Settings,
    step: int,
) -> float:
    share = rate_at(step, steps=settings.steps, warm_up=settings.warm_up, schedule=settings.schedule)
    for group in optimiser.param_groups:
        group["lr"] = settings.learning_rate * share
    batch = pool.sample(
        settings.batch_size,
        seed=settings.seed,
        step=step,
        chunk_length=model.architecture.chunk_length,
        largest_shift=settings.largest_shift,
    )
    with torch.random.fork_rng(devices=[]):  # the paper's noise in the initial tokens, where it is switched on
        torch.manual_seed(int(np.random.SeedSequence([settings.seed, step]).generate_state(1)[0]))
        loss = reader.loss(model, batch)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(weights.values(), settings.clip)
    optimiser.step()
    value = float(loss.detach())
    if not np.isfinite(value):
        raise TrainingError(f"expected a finite loss, got {value} in step {step}; lower the learning rate")
    return value


@torch.no_grad()
def _look_at_held_out(model: MergeVLA, reader: Reader, pool: Pool, settings: Settings, history: History) -> None:
    model.eval()
    batches = pool.held_out(settings.batch_size, chunk_length=model.architecture.chunk_length)
    measured = [(float(reader.loss(model, batch)), int(batch.mask.sum())) for batch in batches]
    model.train()
    if measured:
        losses, counts = zip(*measured, strict=True)
        history.held_out.append((history.step, float(np.average(losses, weights=counts))))


def _pace(history: History, settings: Settings, taken: int, seconds: float) -> Pace:
    rate = taken / seconds if seconds > WARMING_S else None
    return Pace(
        history.step,
        settings.steps,
        float(np.mean(history.losses[-RECENT:])),
        history.held_out[-1][1] if history.held_out else None,
        rate,
        (settings.steps - history.step) / rate if rate else None,
    )


def _metrics(settings: Settings, pool: Pool, history: History) -> dict[str, float]:
    metrics = {
        "seed": settings.seed,
        "steps": settings.steps,
        "batch_size": settings.batch_size,
        "learning_rate": settings.learning_rate,
        "largest_shift": settings.largest_shift,
        "frames": pool.frames,
        "train_l1": float(np.mean(history.losses[-RECENT:])),
        "seconds": round(history.seconds, 1),
    }
    return metrics | ({"held_out_l1": history.held_out[-1][1]} if history.held_out else {})
