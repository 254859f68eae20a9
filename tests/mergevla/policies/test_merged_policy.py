"""Policies of one network, of experts and of merged models: the acting expert, state, and independence of the batch."""

import errno
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import torch

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import PolicyError, Routing, check_fit
from robogauntlet.suites.episode import Episode, Protocol, View
from robogauntlet_mergevla.checkpoints.expert_checkpoint import save_checkpoint
from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.kinds import EXPERTS, KIND, MERGED
from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
from robogauntlet_mergevla.routing.catalog import FITTED, NAMES, fit_routers
from robogauntlet_mergevla.routing.contract import FirstObservation
from tests import ROOT
from tests.errors import one_line_error
from tests.mergevla.experts import TASKS, merging, save_base, save_expert, save_experts
from tests.mergevla.shared import SMALL, query, small_model, task_statistics


def observation(index, task):
    """Brighter for a later task."""
    generator = torch.Generator().manual_seed(index)
    images = torch.rand(2, 3, 16, 16, generator=generator) * 0.2 + 0.3 * TASKS.index(task)
    return FirstObservation(images, task, np.zeros(8), f"{task}{index}", task)


@pytest.fixture(scope="module")
def merged(folders):
    made = merging(folders)
    frames = {task: [observation(index, task) for index in range(8)] for task in TASKS}
    held_out = {task: [observation(index, task) for index in range(8, 12)] for task in TASKS}
    save_merged(folders[0].parents[1] / "merged", made, fit_routers(MergedModel(made.parts), frames, held_out))
    return folders[0].parents[1] / "merged"


@pytest.fixture(params=["single", "experts", "merged"])
def kind_and_options(request, folders, merged):
    return {
        "single": (KIND, {"checkpoint": str(folders[0])}),
        "experts": (EXPERTS, {"folder": str(folders[0].parent)}),
        "merged": (MERGED, {"checkpoint": str(merged)}),
        "oracle-routed": (MERGED, {"checkpoint": str(merged), "router": "oracle"}),
    }[request.param]


def of_task(seed, task=None):
    return query(seed, task=task or TASKS[seed % len(TASKS)])


class Fixed:
    """Routes to one expert and records the episodes."""

    name, sees_instruction = "fixed", True

    def __init__(self, choice):
        self.choice, self.asked = choice, []

    def passes(self, experts):
        return 0

    def route(self, observations, model):
        self.asked += [observation.episode_id for observation in observations]
        return [Routing({self.choice: 1.0}, self.choice, 0.0) for _ in observations]


@pytest.mark.parametrize("kind", [KIND, EXPERTS, MERGED])
def test_the_entry_point_names_the_kind(kind):
    project = tomllib.loads((ROOT / "mergevla" / "pyproject.toml").read_text())
    place = project["project"]["entry-points"]["robogauntlet.policies"][kind.name]
    assert metadata.EntryPoint(kind.name, place, "robogauntlet.policies").load() is kind


def test_hashing_the_kinds_and_planning_with_the_zoo_import_no_torch(folders, merged):
    program = (
        "import sys; from robogauntlet_mergevla.kinds import EXPERTS, KIND, MERGED; "
        "kinds = zip((KIND, EXPERTS, MERGED), ('checkpoint', 'folder', 'checkpoint'), sys.argv[1:]); "
        "[kind.digest({name: place}) for kind, name, place in kinds]; EXPERTS.spec({'folder': sys.argv[2]}); "
        "from robogauntlet.orchestrator.registry import find_suite; "
        "from robogauntlet.orchestrator.runs.plan import make_plan; make_plan(find_suite('mergevla')); "
        "assert not {'torch', 'transformers', 'peft', 'safetensors', 'sklearn'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", program, folders[0], folders[0].parent, merged], check=True)


@pytest.mark.parametrize("kind_and_options", ["single", "experts", "merged", "oracle-routed"], indirect=True)
def test_what_a_policy_needs_is_known_without_loading_it(kind_and_options):
    kind, options = kind_and_options
    assert kind.spec(options) == kind.load(options).spec


def test_actions_do_not_depend_on_the_batch_or_its_order(kind_and_options):
    kind, options = kind_and_options
    queries = [of_task(seed) for seed in range(40)]
    together, reverse = kind.load(options).act(queries), kind.load(options).act(queries[::-1])[::-1]
    policy = kind.load(options)
    for one, decision, turned in zip(queries, together, reverse, strict=True):
        alone = policy.act([one])[0]
        np.testing.assert_allclose(decision.actions, alone.actions, atol=1e-5)
        np.testing.assert_allclose(decision.actions, turned.actions, atol=1e-5)
        assert (decision.routing is None) == (alone.routing is None)
        assert decision.routing is None or decision.routing.choice == alone.routing.choice


def test_an_expert_acts_as_it_does_alone(folders):
    policy = EXPERTS.load({"folder": str(folders[0].parent)})
    for task, folder in zip(TASKS, folders, strict=True):
        alone = KIND.load({"checkpoint": str(folder)}).act([of_task(1, task)])[0]
        np.testing.assert_allclose(policy.act([of_task(1, task)])[0].actions, alone.actions, atol=1e-6)


@pytest.mark.parametrize("options", [{"backbone": "select", "kept_blocks": 2}, {"operator": "ta"}])
def test_a_single_merged_expert_acts_as_before_when_oracle_routed(folders, tmp_path, options):
    save_merged(tmp_path, merging(folders[:1], **options))
    ours = MERGED.load({"checkpoint": str(tmp_path), "router": "oracle"}).act([of_task(0)])[0]
    alone = KIND.load({"checkpoint": str(folders[0])}).act([of_task(0)])[0]
    np.testing.assert_allclose(ours.actions, alone.actions, atol=1e-5)


def test_action_steps_of_experts_are_kept_in_the_merged_policy(tmp_path):
    base = save_base(tmp_path / "base")
    for index, (task, steps) in enumerate(zip(TASKS, (2, None, 8), strict=True)):
        save_expert(tmp_path / "experts" / str(index), base, task, index, action_steps=steps)
    save_merged(tmp_path / "merged", merging(sorted((tmp_path / "experts").iterdir())))
    alone = KIND.load({"checkpoint": str(tmp_path / "experts" / "0")})
    assert alone.act([of_task(0, TASKS[0])])[0].actions.shape == (2, 7)
    for policy in (
        EXPERTS.load({"folder": str(tmp_path / "experts")}),
        MERGED.load({"checkpoint": str(tmp_path / "merged"), "router": "oracle"}),
    ):
        decisions = policy.act([of_task(seed, task) for seed, task in enumerate(TASKS)])
        assert [len(decision.actions) for decision in decisions] == [2, 8, 8]


def test_a_recipe_merges_the_experts_again_with_the_checkpoints_routers(folders, merged):
    recipe = {"operator": "mean", "masks": "none", "kept_blocks": 2}
    options = {"checkpoint": str(merged), "experts": str(folders[0].parent), "recipe": recipe}
    ours = MERGED.load(options).act([of_task(0)])[0]
    parts = merging(folders, **recipe).parts
    expected = MergedPolicy(MergedModel(parts), Fixed(ours.routing.choice)).act([of_task(0)])[0]
    np.testing.assert_allclose(ours.actions, expected.actions, atol=1e-5)
    assert MERGED.digest(options) != MERGED.digest({"checkpoint": str(merged)})
    assert MERGED.digest(options) != MERGED.digest({**options, "recipe": {**recipe, "kept_blocks": 1}})


def test_the_oracle_router_gets_the_true_task(merged):
    policy = MERGED.load({"checkpoint": str(merged), "router": "oracle"})
    decisions = policy.act([of_task(seed) for seed in range(3)])
    assert [decision.routing.choice for decision in decisions] == list(TASKS)
    assert all(decision.routing.latency_s >= 0 for decision in decisions)


def test_the_statistics_are_those_of_the_chosen_expert(folders):
    model = MergedModel(merging(folders, masks="none", kept_blocks=0, merge_output=True).parts)
    one, two = (MergedPolicy(model, Fixed(task)).act([of_task(0)])[0].actions for task in TASKS[:2])
    statistics, state = model.parts.statistics, of_task(0).observation.proprioception
    assert not np.allclose(*(statistics.of(task).normalise_proprioception(state) for task in TASKS[:2]))
    assert not np.allclose(one, two)


def test_the_task_is_inferred_once_and_forgotten_when_the_episode_ends(merged, folders):
    router = Fixed(TASKS[1])
    policy = MergedPolicy(MergedModel(merging(folders).parts), router)
    asked = [of_task(0), of_task(1)]
    episodes = [one.episode for one in asked]
    policy.reset(episodes)
    assert [d.routing.choice for d in policy.act(asked)] == [TASKS[1]] * 2
    assert [d.routing for d in policy.act([replace(one, step=4) for one in asked])] == [None, None]
    policy.finish(episodes[:1])
    assert [d.routing is None for d in policy.act(asked)] == [False, True]
    policy.reset(episodes)
    policy.act(asked)
    assert router.asked == [e.id for e in (*episodes, episodes[0], *episodes)]


def test_two_queries_of_one_new_episode_are_routed_once(folders):
    router = Fixed(TASKS[0])
    policy = MergedPolicy(MergedModel(merging(folders).parts), router)
    decisions = policy.act([of_task(0), replace(of_task(0), step=4)])
    assert len(router.asked) == 1
    assert [decision.routing is None for decision in decisions] == [False, True]


@pytest.mark.parametrize("router", NAMES)
@pytest.mark.parametrize("sees", [True, False])
def test_every_router_drives_the_merged_policy(merged, router, sees):
    policy = MERGED.load({"checkpoint": str(merged), "router": router, "sees_instruction": sees})
    routing = policy.act([of_task(0)])[0].routing
    assert set(routing.scores) == set(TASKS)
    assert routing.choice in TASKS
    assert (routing.unknown is None) == (router not in (*FITTED, "instruction-match"))


def test_options_of_a_router_are_part_of_the_policy(merged):
    options = {"checkpoint": str(merged), "router": "paper-coded:projections=kv,rank=4"}
    routing = MERGED.load(options).act([of_task(0)])[0].routing
    plain = MERGED.load({**options, "router": "paper-coded"}).act([of_task(0)])[0].routing
    assert routing.scores != plain.scores
    assert MERGED.digest(options) != MERGED.digest({**options, "router": "paper-coded"})
    with pytest.raises(PolicyError, match=r"router 'paper-coded:rank=x': expected options .* got 'rank=x'"):
        MERGED.spec({**options, "router": "paper-coded:rank=x"})


@pytest.mark.parametrize("kind_and_options", ["single", "experts", "oracle-routed"], indirect=True)
def test_it_plays_an_episode_twice_the_same(kind_and_options):
    kind, options = kind_and_options
    view = View(image_size=SMALL.image_size)
    simulation, policy = open_simulation("null/Reach", view), kind.load(options)
    check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
    episode = Episode("p", kind.digest(options), "null/Reach", 3, Protocol(horizon=20, view=view))
    one, two = rollout(simulation, policy, episode), rollout(simulation, policy, episode)
    assert (one.queries, one.actions_hash) == (3, two.actions_hash)
    assert one.inferred_task == ("null/Reach" if kind is MERGED else None)


def test_a_shipped_checkpoint_is_found_by_its_name(folders, merged, monkeypatch):
    monkeypatch.setattr("robogauntlet_mergevla.zoo.zoo_folder", lambda: merged.parent)
    assert EXPERTS.digest({"folder": "zoo:experts"}) == EXPERTS.digest({"folder": str(folders[0].parent)})
    assert MERGED.digest({"checkpoint": "zoo:merged"}) == MERGED.digest({"checkpoint": str(merged)})
    MERGED.load({"checkpoint": "zoo:merged"})
    refused(MERGED, {"checkpoint": "zoo:mergd"}, "did you mean 'merged'")


def test_digests_differ_for_other_experts_routers_and_inputs(folders, merged, tmp_path):
    options = {"checkpoint": str(merged)}
    digests = [
        MERGED.digest(options),
        MERGED.digest({**options, "router": "calibrated", "sees_instruction": True}),
        MERGED.digest({**options, "router": "oracle"}),
        MERGED.digest({**options, "sees_instruction": False}),
    ]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3
    whole = EXPERTS.digest({"folder": str(folders[0].parent)})
    base = folders[0].parents[1] / "base"
    for seed, task in enumerate(TASKS, start=1):
        save_expert(tmp_path / "same" / str(seed), base, task, seed)
        save_expert(tmp_path / "other" / str(seed), base, task, seed + 1)
    assert EXPERTS.digest({"folder": str(tmp_path / "same")}) == whole
    assert EXPERTS.digest({"folder": str(tmp_path / "other")}) != whole


def refused(kind, options, match, ask=lambda policy: None):
    with one_line_error(PolicyError, match):
        ask(kind.load(options))


def test_an_episode_whose_task_has_no_expert_is_refused(folders, merged):
    unknown = of_task(0, "null/Reac")
    experts, oracle_routed = {"folder": str(folders[0].parent)}, {"checkpoint": str(merged), "router": "oracle"}
    message = r"expected a task that has an expert, got 'null/Reac'; did you mean 'null/Reach'\?"
    refused(EXPERTS, experts, message, lambda policy: policy.act([unknown]))
    refused(EXPERTS, experts, message, lambda policy: policy.reset([unknown.episode]))
    refused(MERGED, oracle_routed, message, lambda policy: policy.act([unknown]))


@pytest.mark.parametrize("router", ["calibrated", "nearest-centroid"])
def test_a_router_that_was_not_fitted_is_refused_when_the_policy_is_loaded(folders, tmp_path, router):
    save_merged(tmp_path, merging(folders))
    options = {"checkpoint": str(tmp_path), "router": router}
    refused(MERGED, options, f"router '{router}': expected tensors .*, got none")


def test_a_single_network_is_refused_as_merged_and_the_reverse(folders, merged):
    refused(MERGED, {"checkpoint": str(folders[0])}, "expected a merged checkpoint, got a checkpoint of one network")
    refused(KIND, {"checkpoint": str(merged)}, "expected a checkpoint of one network, got a merged checkpoint")


@pytest.mark.parametrize(
    ("kind", "options", "match"),
    [
        (EXPERTS, {}, "expected option folder"),
        (EXPERTS, {"folder": "/nowhere"}, "expected a folder of expert checkpoints, got '/nowhere'"),
        (MERGED, {}, "expected option checkpoint"),
        (MERGED, {"checkpoint": "/nowhere"}, "expected a checkpoint's folder or a hub id"),
        (MERGED, {"checkpoint": "{merged}", "router": ""}, "expected option router"),
        (MERGED, {"checkpoint": "{merged}", "router": "oracel"}, "unknown router 'oracel'; did you mean 'oracle'"),
        (MERGED, {"checkpoint": "{merged}", "recipe": {}}, "expected options recipe and experts together, got one"),
        (
            MERGED,
            {"checkpoint": "{merged}", "recipe": {"operater": "ta"}, "experts": "x"},
            "recipe for merging: operater: Unexpected keyword argument",
        ),
        (MERGED, {"checkpoint": "{merged}", "sees_instruction": "no"}, "sees_instruction: true or false, got 'no'"),
        (
            MERGED,
            {"checkpoint": "{merged}", "expert_sees_instruction": 0},
            "expert_sees_instruction: true or false, got",
        ),
    ],
)
def test_options_that_do_not_fit_are_refused(kind, options, match, merged):
    filled = {name: value.format(merged=merged) if isinstance(value, str) else value for name, value in options.items()}
    refused(kind, filled, match)


@pytest.mark.parametrize(
    ("recipe", "match"),
    [
        ({"operator": "tis"}, "unknown merge operator 'tis'; did you mean 'ties'"),
        ({"options": {"drop": 0.5}}, "operator 'ties' has no option 'drop'"),
        (
            {"lambda_": {"null/Reach": 0.4}},
            "expected a lambda for each of null/Raise, null/Reach, null/Slow; null/Raise",
        ),
        ({"kept_blocks": 3}, r"expected k, the blocks kept per task, to be a whole number in \[0, 2\], got 3"),
    ],
)
def test_a_recipe_that_does_not_fit_is_refused_when_a_run_is_planned(recipe, match, folders, merged):
    with pytest.raises(PolicyError, match=match):
        MERGED.spec({"checkpoint": str(merged), "experts": str(folders[0].parent), "recipe": recipe})


@pytest.mark.parametrize("use", [MERGED.spec, MERGED.load])
def test_a_fitted_router_is_not_used_with_experts_of_another_base(use, merged, tmp_path):
    strangers = save_base(tmp_path / "base", seed=7)
    for seed, task in enumerate(TASKS):
        save_expert(tmp_path / "experts" / str(seed), strangers, task, seed)
    options = {"checkpoint": str(merged), "experts": str(tmp_path / "experts"), "recipe": {}}
    with pytest.raises(PolicyError, match="router 'calibrated': expected experts of the base that it was fitted to"):
        use(options)
    use({**options, "router": "oracle"})


def test_a_second_expert_for_a_task_is_refused(folders, tmp_path):
    base = folders[0].parents[1] / "base"
    for name in "ab":
        save_expert(tmp_path / name, base, "null/Reach", 1)
    refused(EXPERTS, {"folder": str(tmp_path)}, "expected one expert per task, got .*a and .*b for null/Reach")


def test_a_folder_without_experts_is_refused(tmp_path):
    save_checkpoint(tmp_path / "base", small_model(), CheckpointMetadata(SMALL, task_statistics()))
    refused(EXPERTS, {"folder": str(tmp_path)}, "which holds none")


def test_an_unreadable_expert_is_an_error(tmp_path, monkeypatch):
    """The error is simulated, since root may read everything."""
    denied = save_experts(tmp_path)[1]
    is_file = Path.is_file

    def deny(path):
        if denied in path.parents:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return is_file(path)

    monkeypatch.setattr(Path, "is_file", deny)
    message = f"expected to read '{denied / 'card.json'}', got: Permission denied"
    refused(EXPERTS, {"folder": str(denied.parent)}, message)


def test_a_base_and_a_merged_model_in_the_folder_are_left_out(tmp_path, merged, folders):
    save_experts(tmp_path)
    (tmp_path / "base").rename(tmp_path / "experts" / "base")
    for place in (tmp_path / "experts").glob("null-*"):
        metadata = place / "card.json"
        metadata.write_text(metadata.read_text().replace('"../../base"', '"../base"'))
    save_merged(tmp_path / "experts" / "merged", merging(sorted((tmp_path / "experts").glob("null-*"))))
    options = {"folder": str(tmp_path / "experts")}
    assert EXPERTS.digest(options) == EXPERTS.digest({"folder": str(folders[0].parent)})


def test_a_query_without_an_observation_is_refused(kind_and_options):
    queries = [replace(query(0), observation=None)]
    refused(*kind_and_options, "an observation in each query", lambda policy: policy.act(queries))


def test_no_queries_give_no_decisions(kind_and_options):
    kind, options = kind_and_options
    assert kind.load(options).act([]) == []


@pytest.mark.parametrize("kind", [EXPERTS, MERGED])
def test_missing_packages_are_one_line(kind, folders, merged, monkeypatch):
    for name in ("single_policy", "merged_policy"):
        monkeypatch.setitem(sys.modules, f"robogauntlet_mergevla.policies.{name}", None)
    options = {"folder": str(folders[0].parent), "checkpoint": str(merged)}
    message = rf"policy '{kind.name}': not installed .*: pip install \./mergevla"
    refused(kind, options, message)


@pytest.mark.parametrize("kind", [EXPERTS, MERGED])
def test_so_are_they_before_anything_is_loaded(kind, folders, merged, monkeypatch):
    monkeypatch.setattr("robogauntlet_mergevla.options.find_spec", lambda name: None)
    with one_line_error(PolicyError, rf"policy '{kind.name}': not installed \(no module torch\)"):
        kind.spec({"folder": str(folders[0].parent), "checkpoint": str(merged)})
