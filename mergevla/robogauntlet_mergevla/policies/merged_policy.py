"""The policy of a merged model: the router chooses the expert that acts in an episode."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies.contract import Decision, PolicyError, PolicyMismatch, PolicySpec, Query, Routing
from robogauntlet.suites.episode import Episode
from robogauntlet_mergevla.checkpoints.merge_experts import Experts, merge_parts, read_experts
from robogauntlet_mergevla.checkpoints.merged_checkpoint import MergedCheckpoint, load_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.checkpoints.metadata import WEIGHTS, CheckpointMetadata, locate
from robogauntlet_mergevla.merging.masks import lambdas_of
from robogauntlet_mergevla.merging.merge import check_operator
from robogauntlet_mergevla.merging.parts import check_blocks
from robogauntlet_mergevla.merging.recipe import MaskRule, Recipe
from robogauntlet_mergevla.merging.trunk import check_kept_blocks
from robogauntlet_mergevla.options import MergedOptions, expert_folders
from robogauntlet_mergevla.policies.single_policy import (
    Network,
    chunks_by,
    device_named,
    observed,
    stack_images,
)
from robogauntlet_mergevla.routing.catalog import FITTED, router as router_named
from robogauntlet_mergevla.routing.contract import FirstObservation, Router, named_for
from robogauntlet_mergevla.spec import merged_spec


class MergedPolicy:
    """Acts as the expert of a merged model that the router chose from the episode's first observation.

    The choice is kept until the episode ends. Uses one thread.
    """

    def __init__(self, model: MergedModel, router: Router, *, expert_sees_instruction: bool = True) -> None:
        """Take a model and a router; `expert_sees_instruction` as in `options.MergedOptions`.

        Raises PolicyError without it if an expert has several tasks, of which the router names none.
        """
        several = [expert for expert, tasks in model.tasks.items() if len(tasks) > 1]
        if several and not expert_sees_instruction:
            raise PolicyError(
                f"expected experts of one task each with expert_sees_instruction: false, got several of {several[0]}"
            )
        self._sees_instruction = expert_sees_instruction
        torch.set_num_threads(1)
        self.spec = merged_spec(model.architecture, model.parts.statistics.action_dims, model.expert_of, router.name)
        self._model, self._router = model, router
        self._chosen: dict[str, str] = {}
        if router.passes(len(model.experts)):
            # Networks and subspaces are built on first use, which would count as the first episode's latency.
            size = model.architecture.image_size
            images = torch.zeros(len(model.architecture.cameras), 3, size, size)
            task = next(iter(model.expert_of))
            proprioception = np.zeros(model.architecture.proprioception_dim)
            router.route([FirstObservation(images, "", proprioception, "", task)], model)

    @classmethod
    def of(cls, options: MergedOptions) -> MergedPolicy:
        """Load a merged checkpoint, or merge experts if the options have a recipe.

        The options decide whether router and acting expert read the instruction. Raises PolicyError if a checkpoint
        cannot be used, or the router is unknown or was not fitted.
        """
        device = device_named(options.device)
        checkpoint = _checkpoint(*_version(locate(options.checkpoint)))
        router = router_named(options.router, sees_instruction=options.sees_instruction, stored=checkpoint.fitted)
        if options.recipe is not None and options.experts is not None:
            folders = expert_folders(options.experts)
            _check_recipe(options.recipe, folders, options.router, checkpoint)
            experts = _experts(tuple(map(_version, dict.fromkeys(folders.values()))))
            parts = merge_parts(experts, options.recipe, checkpoint.metadata.instructions)
        else:
            parts = checkpoint.parts
        model = MergedModel(parts, device=device)
        return cls(model, router, expert_sees_instruction=options.expert_sees_instruction)

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes without a choice."""
        self.finish(episodes)

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes."""
        for episode in episodes:
            self._chosen.pop(episode.id, None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return a chunk for each query, with the routing for the first of an episode.

        An answer does not depend on the rest of its batch (within 1e-5).
        """
        observations = observed(queries)
        new = self._route(queries, observations)
        experts = [self._chosen[query.episode.id] for query in queries]
        if not self._sees_instruction:
            known, tasks = self._model.instructions, self._model.tasks
            observations = [
                replace(observation, instruction=known[tasks[expert][0]])
                for observation, expert in zip(observations, experts, strict=True)
            ]
        chunks = chunks_by(observations, experts, experts, self._network)
        return [Decision(chunk, new.pop(query.episode.id, None)) for query, chunk in zip(queries, chunks, strict=True)]

    def _route(self, queries: Sequence[Query], observations: Sequence[Observation]) -> dict[str, Routing]:
        """Choose the expert of each new episode and return the routing by episode."""
        new: dict[str, FirstObservation] = {}
        for query, observation in zip(queries, observations, strict=True):
            episode = query.episode
            if episode.id not in self._chosen and episode.id not in new:
                images = stack_images([observation], self.spec.cameras)[0]
                new[episode.id] = FirstObservation(
                    images, observation.instruction, observation.proprioception, episode.id, episode.task
                )
        if not new:
            return {}
        started = time.perf_counter()
        answers = self._router.route(list(new.values()), self._model)
        waited = time.perf_counter() - started
        self._chosen |= {name: routed.choice for name, routed in zip(new, answers, strict=True)}
        return {
            name: replace(named_for(routed, seen.task, self._model), latency_s=waited)
            for (name, seen), routed in zip(new.items(), answers, strict=True)
        }

    def _network(self, expert: str) -> Network:
        parts = self._model.parts
        steps = parts.action_steps.get(expert)
        return Network(self._model.model(expert), parts.statistics, self._model.tokenizer, steps)


def checked_spec(options: MergedOptions) -> PolicySpec:
    """Return the spec of a merged policy, after checking everything except the merging itself.

    Raises PolicyError if a checkpoint cannot be used, the router is unknown or was not fitted, or experts to be merged
    do not fit the recipe or the router.
    """
    checkpoint = _checkpoint(*_version(locate(options.checkpoint)))
    router_named(options.router, sees_instruction=options.sees_instruction, stored=checkpoint.fitted)
    tasks: Collection[str] = checkpoint.metadata.instructions
    action_dims = checkpoint.metadata.statistics.action_dims
    if options.recipe is not None and options.experts is not None:
        tasks = folders = expert_folders(options.experts)
        _check_recipe(options.recipe, folders, options.router, checkpoint)
        experts = [CheckpointMetadata.read(folder).statistics for folder in folders.values()]
        action_dims = frozenset().union(*(one.action_dims for one in experts))
    return merged_spec(checkpoint.metadata.architecture, action_dims, tasks, options.router)


def _version(folder: Path) -> tuple[Path, int]:
    """A checkpoint's folder and when its weights changed (ns), so that a newer one is read in place of a cached one."""
    return folder, (folder / WEIGHTS).stat().st_mtime_ns if (folder / WEIGHTS).exists() else 0


@lru_cache(maxsize=2)
def _checkpoint(folder: Path, changed_ns: int) -> MergedCheckpoint:
    """Load a checkpoint, which suites name many times."""
    return load_merged(folder)


@lru_cache(maxsize=1)
def _experts(versions: tuple[tuple[Path, int], ...]) -> Experts:
    """Load experts, which suites name many times."""
    return read_experts(folder for folder, _ in versions)


def _check_recipe(recipe: Recipe, folders: Mapping[str, Path], router: str, checkpoint: MergedCheckpoint) -> None:
    """Raise PolicyError for an invalid recipe, or experts of another base than the fitted router's."""
    check_operator(recipe.operator, recipe.options)
    layers = checkpoint.metadata.architecture.language.layers
    check_kept_blocks(recipe.kept_blocks, layers)
    check_blocks(recipe.only, layers)
    if recipe.masks is MaskRule.TASK:
        lambdas_of({CheckpointMetadata.read(folder).expert: {} for folder in folders.values()}, recipe.lambda_)
    expected = checkpoint.metadata.base_hash
    for task, folder in folders.items() if router in FITTED else ():
        base_hash = CheckpointMetadata.read(folder).base_hash or "none"
        if base_hash != expected:
            raise PolicyMismatch(
                f"router '{router}': expected experts of the base that it was fitted to, {expected[:16]}, "
                f"got one of {base_hash[:16]} for {task}"
            )
