"""Experts and merged models that act: each query by the network that its episode calls for."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from adapters.contract import PROPRIOCEPTION_DIM, FloatArray, Observation
from policies.contract import Decision, PolicyError, PolicyMismatch, PolicySpec, Query, Routing, StatelessPolicy
from policies.mergevla.acting import (
    Network,
    chunks_by,
    device_here,
    load_network,
    observed,
    policy_spec,
    stack_images,
)
from policies.mergevla.card import WEIGHTS, locate, read_card
from policies.mergevla.merged_checkpoint import MergedCheckpoint, load_merged
from policies.mergevla.merged_model import MOST_MODELS, MergedModel
from policies.mergevla.merged_policy import MergedOptions, expert_folders
from policies.mergevla.merging.masks import lambdas_of
from policies.mergevla.merging.operators import operator_with
from policies.mergevla.merging.recipe import MaskRule, Recipe
from policies.mergevla.merging.trunk import check_kept_blocks
from policies.mergevla.merging_experts import merge_parts, read_experts
from policies.mergevla.routing.catalog import FITTED
from policies.mergevla.routing.catalog import router as router_named
from policies.mergevla.routing.contract import Routed, Router, Sighting
from suites.plugins import nearest
from suites.vocabulary import Episode


class ExpertsPolicy(StatelessPolicy):
    """Acts by the expert of the episode's task: what merging is measured against. Takes one thread."""

    def __init__(self, folders: Mapping[str, Path], *, most_models: int = MOST_MODELS) -> None:
        """Take experts; each is read when its task first comes up.

        Args:
            folders: Task to its expert's checkpoint.
            most_models: Networks kept in memory.

        Raises:
            PolicyError: They do not need or produce the same.
        """
        torch.set_num_threads(1)
        specs = {task: policy_spec(read_card(folder).architecture) for task, folder in folders.items()}
        first, self.spec = next(iter(specs.items()))
        for task, spec in specs.items():
            if spec != self.spec:
                raise PolicyMismatch(f"expected experts of one architecture, got others for {first} and {task}")
        self._folders, self._most_models = dict(folders), most_models
        self._networks: OrderedDict[str, Network] = OrderedDict()

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Refuse episodes of a task that no expert was trained on."""
        for episode in episodes:
            self._check(episode.task)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """A chunk for each query; an answer does not depend on what else is in its batch (within 1e-5)."""
        observations, tasks = observed(queries), [self._check(query.episode.task) for query in queries]
        return [Decision(chunk) for chunk in chunks_by(observations, tasks, self._chunks)]

    def _chunks(self, task: str, observations: Sequence[Observation]) -> FloatArray:
        if task not in self._networks:
            self._networks[task] = load_network(self._folders[task], device_here())
            while len(self._networks) > self._most_models:
                self._networks.popitem(last=False)
        self._networks.move_to_end(task)
        return self._networks[task].chunks(observations, [task] * len(observations))

    def _check(self, task: str) -> str:
        if task not in self._folders:
            raise PolicyError(f"expected a task that has an expert, got '{task}'{nearest(task, self._folders)}")
        return task


class MergedPolicy:
    """Acts by a merged model as the expert that the router chose from the episode's first observation.

    The choice is kept until the episode ends. Takes one thread.
    """

    def __init__(self, model: MergedModel, router: Router) -> None:
        torch.set_num_threads(1)
        self.spec = policy_spec(model.architecture)
        self._model, self._router = model, router
        self._chosen: dict[str, str] = {}
        if router.passes(len(model.experts)):
            # What is made at the first use only, such as networks and subspaces, would count as the first episode's
            # latency.
            router.route([_blank(model)], model)

    @classmethod
    def of(cls, options: MergedOptions) -> MergedPolicy:
        """The policy of a merged checkpoint, or of experts that are merged now.

        Whether the router reads the instruction is said by the options; the expert that acts always does.

        Raises:
            PolicyError: A checkpoint cannot be used, or the router is unknown or was not fitted.
        """
        checkpoint = load_merged(options.checkpoint)
        router = router_named(options.router, sees_instruction=options.sees_instruction, stored=checkpoint.fitted)
        parts = checkpoint.parts
        if options.recipe is not None and options.experts is not None:
            folders = expert_folders(options.experts)
            _check_anew(options.recipe, folders, options.router, checkpoint)
            experts = read_experts(folders.values())
            parts = merge_parts(experts, options.recipe, parts.instructions)
        return cls(MergedModel(parts, device=device_here()), router)

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes: nothing is known of them."""
        self.finish(episodes)

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes."""
        for episode in episodes:
            self._chosen.pop(episode.id, None)

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """A chunk for each query, and the routing with an episode's first.

        An answer does not depend on what else is in its batch (within 1e-5).
        """
        observations = observed(queries)
        new = self._route(queries, stack_images(observations, self.spec.cameras) if observations else torch.empty(0))
        experts = [self._chosen[query.episode.id] for query in queries]
        chunks = chunks_by(observations, experts, self._chunks)
        return [Decision(chunk, new.pop(query.episode.id, None)) for query, chunk in zip(queries, chunks, strict=True)]

    def _route(self, queries: Sequence[Query], images: Tensor) -> dict[str, Routing]:
        """Choose for the episodes that are new; what was chosen, by episode."""
        sightings: dict[str, Sighting] = {}
        for query, frames in zip(queries, images, strict=True):
            episode, observation = query.episode, query.observation
            assert observation is not None
            if episode.id not in self._chosen and episode.id not in sightings:
                sightings[episode.id] = Sighting(
                    frames, observation.instruction, observation.proprioception, episode.id, episode.task
                )
        if not sightings:
            return {}
        started = time.perf_counter()
        answers = self._router.route(list(sightings.values()), self._model)
        waited = time.perf_counter() - started
        self._chosen |= {name: routed.choice for name, routed in zip(sightings, answers, strict=True)}
        return {name: _routing(routed, waited) for name, routed in zip(sightings, answers, strict=True)}

    def _chunks(self, expert: str, observations: Sequence[Observation]) -> FloatArray:
        parts = self._model.parts
        steps = parts.action_steps.get(expert)
        network = Network(self._model.model(expert), parts.statistics, self._model.tokenizer, steps)
        return network.chunks(observations, [expert] * len(observations))


def merged_spec(options: MergedOptions) -> PolicySpec:
    """What a merged policy needs and produces, with everything checked but the merging itself.

    Raises:
        PolicyError: A checkpoint cannot be used, the router is unknown or was not fitted, or experts that are to be
            merged anew do not fit the recipe or the router.
    """
    folder = locate(options.checkpoint)
    checkpoint = _checkpoint(folder, (folder / WEIGHTS).stat().st_mtime_ns if (folder / WEIGHTS).exists() else 0)
    router_named(options.router, sees_instruction=options.sees_instruction, stored=checkpoint.fitted)
    if options.recipe is not None and options.experts is not None:
        _check_anew(options.recipe, expert_folders(options.experts), options.router, checkpoint)
    return policy_spec(checkpoint.parts.architecture)


@lru_cache(maxsize=2)
def _checkpoint(folder: Path, changed_ns: int) -> MergedCheckpoint:
    """Suites name one checkpoint many times. Args: changed_ns: When, so that a newer one is read."""
    return load_merged(folder)


def _check_anew(recipe: Recipe, folders: Mapping[str, Path], router: str, checkpoint: MergedCheckpoint) -> None:
    """Refuse a recipe that cannot be, and experts whose base a fitted router of the checkpoint does not know.

    Raises:
        PolicyError: It is one, or they are.
    """
    operator_with(recipe.operator, recipe.options)
    check_kept_blocks(recipe.kept_blocks, checkpoint.card.architecture.language.layers)
    if recipe.masks is MaskRule.TASK:
        lambdas_of({task: {} for task in folders}, recipe.lambda_)
    expected = checkpoint.card.base_hash
    for task, folder in folders.items() if router in FITTED else ():
        came = read_card(folder).base_hash or "none"
        if came != expected:
            raise PolicyMismatch(
                f"router '{router}': expected experts of the base that it was fitted to, {expected[:16]}, "
                f"got one of {came[:16]} for {task}"
            )


def _routing(routed: Routed, waited: float) -> Routing:
    """Args: waited: Seconds until the answer came, those of a batch together: so long every episode in it waited."""
    return Routing(routed.scores, routed.choice, waited, routed.unknown, routed.rejected)


def _blank(model: MergedModel) -> Sighting:
    architecture = model.architecture
    images = torch.zeros(len(architecture.cameras), 3, architecture.image_size, architecture.image_size)
    return Sighting(images, "", np.zeros(PROPRIOCEPTION_DIM), "", model.experts[0])
