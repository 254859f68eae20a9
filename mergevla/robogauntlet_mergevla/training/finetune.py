"""Trains MergeVLA: a base on the pooled demonstrations of all tasks, then experts of one or several from it.

The loss is the mean L1 over the normalised action chunk (arXiv 2511.18810), past the episode's end left out. The paper
starts from a pretrained vision-language model and initialises each expert's trunk; this base holds the trunk too, so
that experts share their initialisation and task vectors are defined for all of it. A base without actions, as the
paper's, is trained to match images and sentences.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from robogauntlet.suites.episode import content_hash
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, save_checkpoint
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, CheckpointMetadata, check_action_steps
from robogauntlet_mergevla.network.config import Architecture, LoraSettings
from robogauntlet_mergevla.network.lora import BACKBONE, add_lora
from robogauntlet_mergevla.network.model import MergeVLA, build
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.training.batch_loss import BatchLoss, Objective
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.settings import Settings, rate_at
from robogauntlet_mergevla.training.training_checkpoint import (
    STATE_FILE,
    History,
    TrainingError,
    load_state,
    save_state,
)

CURVE_FILE = "losses.json"
RECENT = 50
"""Number of steps over which the displayed training loss is averaged."""
WARMING_S = 1.0
"""Time after which a pace is reported."""


@dataclass(frozen=True)
class TrainingStatus:
    """Progress of a training."""

    step: int
    """Steps taken."""
    steps: int
    loss: float
    """Mean of the objective over the last steps."""
    held_out: float | None
    """Latest on held-out episodes, if there are any."""
    steps_per_s: float | None
    left_s: float | None
    objective: Objective


@dataclass(frozen=True)
class TrainingResult:
    """Result of a training."""

    metadata: CheckpointMetadata | None
    """The checkpoint's, or None if the training was stopped before its end."""
    history: History
    objective: Objective


Listener = Callable[[TrainingStatus], None]
"""Called after every step."""
Stop = Callable[[], bool]
"""Asked after every step whether to stop; the state is saved then."""


def pretrain(
    mixture: DatasetMixture,
    architecture: Architecture,
    out: Path,
    settings: Settings,
    *,
    action_steps: int | None = None,
    objective: Objective = Objective.L1,
    prepare: Callable[[MergeVLA], None] | None = None,
    listener: Listener = lambda status: None,
    stop: Stop = lambda: False,
) -> TrainingResult:
    """Train all weights of the base that experts start from, and save it to `out`.

    Args:
        mixture: Demonstrations of all tasks, each normalised by its own statistics: otherwise the task with the widest
            motions would dominate the loss.
        architecture: Architecture of the network.
        out: Folder of the checkpoint. A training that was stopped there is continued.
        settings: Training settings.
        action_steps: See `CheckpointMetadata.action_steps`; it does not affect the training.
        objective: With `Objective.MATCHING` only the backbone and the action queries are trained, and no action is
            read: the paper's base has seen none either.
        prepare: Loads pretrained weights into the new network.
        listener: See `Listener`.
        stop: See `Stop`.

    Raises:
        PolicyError: Images that do not fit the architecture, or a folder that holds something else.
    """
    check_action_steps(action_steps, architecture)
    architecture = architecture.with_numbers(mixture.action_dim, mixture.proprioception_dim)
    check_data(mixture, architecture)
    model = build(architecture, settings.seed)
    if prepare is not None:
        prepare(model)
    metadata = CheckpointMetadata(
        architecture,
        mixture.statistics,
        action_steps=action_steps,
        data_hash=mixture.data_hash,
        metrics={} if objective is Objective.L1 else {"without_actions": 1},
    )
    return _train(model, metadata, None, mixture, out, settings, listener, stop, objective)


def finetune(
    mixture: DatasetMixture,
    base: str | Path,
    out: Path,
    settings: Settings,
    *,
    lora: LoraSettings,
    action_steps: int | None = None,
    fresh_trunk: int | None = None,
    dtype: torch.dtype | None = None,
    listener: Listener = lambda status: None,
    stop: Stop = lambda: False,
) -> TrainingResult:
    """Train an expert from a base, adapters on the backbone and all other weights, and save it to `out`.

    Args:
        mixture: Demonstrations of the expert's tasks. Their statistics normalise, as in the paper; several tasks have
            them in common, since a router chooses the expert, not one of its tasks.
        base: The base's folder or hub id; it must stay in place.
        out: See `pretrain`, as for the other arguments. Its name becomes that of an expert of several tasks.
        settings: Training settings.
        lora: Settings of the adapters.
        action_steps: See `CheckpointMetadata.action_steps`.
        fresh_trunk: Seed from which action queries, proprioception and action expert are initialised, as the
            paper's experts are (arXiv 2511.18810); None to continue from the base's.
        dtype: Type to which the weights are rounded in the checkpoint; None for fp32, in which they are trained.
        listener: See `Listener`.
        stop: See `Stop`.

    Raises:
        PolicyError: A base that is an expert, images that do not fit it, or a folder that holds something else.
    """
    start = load_checkpoint(base)
    if start.metadata.base is not None or start.metadata.lora is not None:
        raise TrainingError(f"expected a base, got '{base}', an expert")
    if isinstance(base, Path) and base.resolve() == out.resolve():
        raise TrainingError(f"expected a folder other than the base's for the expert, got '{out}'")
    check_data(mixture, start.model.architecture)
    check_action_steps(action_steps, start.model.architecture)
    if fresh_trunk is not None:
        fresh = build(start.model.architecture, fresh_trunk).state_dict()
        trunk = {name: weight for name, weight in fresh.items() if not name.startswith(BACKBONE)}
        start.model.load_state_dict(trunk, strict=False)
    # A base in bf16 is exact in fp32, in which small steps are not lost.
    add_lora(start.model.float(), lora, settings.seed)
    several = len(mixture.tasks) > 1
    metadata = CheckpointMetadata(
        start.model.architecture,
        mixture.statistics.together(out.resolve().name) if several else mixture.statistics,
        trained_on=mixture.tasks if several else (),
        action_steps=action_steps,
        lora=lora,
        data_hash=mixture.data_hash,
        base_hash=start.metadata.tensor_hash,
        metrics={} if fresh_trunk is None else {"fresh_trunk": fresh_trunk},
    )
    return _train(start.model, metadata, base, mixture, out, settings, listener, stop, dtype=dtype)


def check_data(mixture: DatasetMixture, architecture: Architecture) -> None:
    """Raise TrainingError if a camera is missing in the data, its images have another size, or its actions do."""
    missing = [camera for camera in architecture.cameras if camera not in mixture.cameras]
    if missing:
        raise TrainingError(f"expected images of camera {missing[0]}, the data has {', '.join(mixture.cameras)}")
    if mixture.image_size != architecture.image_size:
        raise TrainingError(
            f"expected {architecture.image_size} px images for architecture '{architecture.name}', "
            f"the data has {mixture.image_size} px"
        )
    for what in ("action_dim", "proprioception_dim"):
        if (expected := getattr(architecture, what)) < (found := getattr(mixture, what)):
            kind = "actions" if what == "action_dim" else "proprioception"
            raise TrainingError(f"expected {kind} of {expected} numbers, as the base's, the data has {found}")


@contextmanager
def repeatable() -> Iterator[None]:
    """Let equal trainings on a GPU give equal bits during the block, as they do on a CPU."""
    if not torch.cuda.is_available():
        yield
        return
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    attention = torch.backends.cuda.mem_efficient_sdp_enabled()
    torch.use_deterministic_algorithms(True, warn_only=True)
    torch.backends.cuda.enable_mem_efficient_sdp(False)  # its gradients differ from run to run
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])
        torch.backends.cuda.enable_mem_efficient_sdp(attention)


@repeatable()
def _train(
    model: MergeVLA,
    metadata: CheckpointMetadata,
    base: str | Path | None,
    mixture: DatasetMixture,
    out: Path,
    settings: Settings,
    listener: Listener,
    stop: Stop,
    objective: Objective = Objective.L1,
    dtype: torch.dtype | None = None,
) -> TrainingResult:
    if (out / METADATA_FILE).exists():
        raise TrainingError(f"expected a folder without a checkpoint, '{out}' holds a finished one")
    torch.set_num_threads(settings.threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    model = model.to(device).train()
    tokenizer = tokenizer_for(model.architecture)
    batch_loss = BatchLoss(model.architecture, metadata.statistics, tokenizer, device, objective)
    weights = {name: weight for name, weight in model.named_parameters() if weight.requires_grad}
    optimiser = torch.optim.AdamW(
        weights.values(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    # Batches depend on the order of episodes, which the data's hash does not include.
    order = [dataset.episode_hashes for dataset in mixture.datasets]
    identity = content_hash({"card": metadata.as_json(), "settings": settings.decisive, "order": order})
    history = load_state(out / STATE_FILE, weights, optimiser, identity) or History(identity)
    began, before, saved = time.monotonic(), history.step, time.monotonic()
    seconds_before = history.seconds
    while history.step < settings.steps:
        history.losses.append(_step(model, batch_loss, mixture, weights, optimiser, settings, history.step))
        history.step += 1
        evaluating = history.step % settings.evaluate_every == 0 or history.step == settings.steps
        if evaluating and objective is Objective.L1:  # A held-out batch has one sentence, so nothing to match.
            _evaluate(model, batch_loss, mixture, settings, history)
        now = time.monotonic()
        history.seconds = seconds_before + now - began
        listener(_pace(history, settings, history.step - before, now - began, objective))
        stopping = stop() and history.step < settings.steps
        if stopping or now - saved >= settings.save_s:
            save_state(out / STATE_FILE, weights, optimiser, history)
            saved = now
        if stopping:
            return TrainingResult(None, history, objective)
    written = save_checkpoint(
        out,
        model,
        replace(metadata, metrics={**metadata.metrics, **_metrics(settings, mixture, history, objective)}),
        base,
        dtype=dtype,
    )
    curve = {"train": [round(loss, 5) for loss in history.losses], "held_out": history.held_out}
    (out / CURVE_FILE).write_text(json.dumps(curve) + "\n", encoding="utf-8")
    (out / STATE_FILE).unlink(missing_ok=True)
    return TrainingResult(written, history, objective)


def _step(
    model: MergeVLA,
    batch_loss: BatchLoss,
    mixture: DatasetMixture,
    weights: dict[str, nn.Parameter],
    optimiser: torch.optim.AdamW,
    settings: Settings,
    step: int,
) -> float:
    share = rate_at(step, steps=settings.steps, warm_up=settings.warm_up, schedule=settings.schedule)
    for group in optimiser.param_groups:
        group["lr"] = settings.learning_rate * share
    batch = mixture.sample(
        settings.batch_size,
        seed=settings.seed,
        step=step,
        chunk_length=model.architecture.chunk_length,
        largest_shift=settings.largest_shift,
        changed_words=settings.changed_words,
    )
    with torch.random.fork_rng(devices=[]):  # the paper's noise in the initial tokens, where it is switched on
        torch.manual_seed(int(np.random.SeedSequence([settings.seed, step]).generate_state(1)[0]))
        loss = batch_loss.loss(model, batch)
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(weights.values(), settings.clip)
    optimiser.step()
    value = float(loss.detach())
    if not np.isfinite(value):
        raise TrainingError(f"expected a finite loss, got {value} in step {step}; lower the learning rate")
    return value


@torch.no_grad()
def _evaluate(
    model: MergeVLA, batch_loss: BatchLoss, mixture: DatasetMixture, settings: Settings, history: History
) -> None:
    model.eval()
    batches = mixture.held_out(settings.batch_size, chunk_length=model.architecture.chunk_length)
    measured = [(float(batch_loss.loss(model, batch)), int(batch.mask.sum())) for batch in batches]
    model.train()
    if measured:
        losses, counts = zip(*measured, strict=True)
        history.held_out.append((history.step, float(np.average(losses, weights=counts))))


def _pace(history: History, settings: Settings, taken: int, seconds: float, objective: Objective) -> TrainingStatus:
    rate = taken / seconds if seconds > WARMING_S else None
    return TrainingStatus(
        history.step,
        settings.steps,
        float(np.mean(history.losses[-RECENT:])),
        history.held_out[-1][1] if history.held_out else None,
        rate,
        (settings.steps - history.step) / rate if rate else None,
        objective,
    )


def _metrics(settings: Settings, mixture: DatasetMixture, history: History, objective: Objective) -> dict[str, float]:
    metrics = {
        "seed": settings.seed,
        "steps": settings.steps,
        "batch_size": settings.batch_size,
        "learning_rate": settings.learning_rate,
        "largest_shift": settings.largest_shift,
        "frames": mixture.frames,
        f"train_{objective}": float(np.mean(history.losses[-RECENT:])),
        "seconds": round(history.seconds, 1),
    }
    if settings.changed_words:
        metrics["changed_words"] = settings.changed_words
    return metrics | ({f"held_out_{objective}": history.held_out[-1][1]} if history.held_out else {})
