"""Experts of several tasks: merged, routed and evaluated by expert, as the suites of arXiv 2511.18810 are."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.policies.contract import PolicyError, check_tasks
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, save_checkpoint
from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged, save_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, CheckpointError, CheckpointMetadata
from robogauntlet_mergevla.kinds import EXPERTS, MERGED
from robogauntlet_mergevla.merging.errors import MergeError
from robogauntlet_mergevla.routing.baselines import InstructionMatchRouter, OracleRouter
from robogauntlet_mergevla.routing.catalog import fit_routers, router
from robogauntlet_mergevla.routing.contract import FirstObservation, named_for
from robogauntlet_mergevla.routing.evaluation import evaluate_routers
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from tests.errors import one_line_error
from tests.mergevla.experts import TASKS, merging, save_base, save_expert
from tests.mergevla.shared import query, some_statistics
from tests.mergevla.training.test_finetune import dataset

BOTH = TASKS[:2]
NAME = "kitchen"


@pytest.fixture(scope="module")
def experts(tmp_path_factory):
    """One of two tasks and one of a single task."""
    folder = tmp_path_factory.mktemp("several")
    base = save_base(folder / "base")
    return [
        save_expert(folder / "experts" / NAME, base, NAME, 1, several=BOTH),
        save_expert(folder / "experts" / "raise", base, TASKS[2], 2),
    ]


def observation(index, task):
    """Brighter for a later task."""
    images = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(index)) * 0.2
    return FirstObservation(images + 0.3 * TASKS.index(task), task, np.zeros(8), f"{task}{index}", task)


def frames(first, count):
    return {task: [observation(index, task) for index in range(first, first + count)] for task in TASKS}


@pytest.fixture(scope="module")
def model(experts):
    return MergedModel(merging(experts).parts)


@pytest.fixture(scope="module")
def merged(experts, model):
    folder = experts[0].parents[1] / "merged"
    save_merged(folder, merging(experts), fit_routers(model, frames(0, 8), frames(8, 4)))
    return folder


def test_a_merge_has_an_expert_for_each_checkpoint_and_an_instruction_for_each_task(model, merged):
    metadata = load_merged(merged).metadata
    assert model.experts == metadata.experts == (NAME, TASKS[2])
    assert metadata.tasks == {NAME: BOTH, TASKS[2]: (TASKS[2],)}
    assert metadata.instructions.keys() == set(TASKS)
    assert model.parts.statistics.of(NAME) == some_statistics(1)


def test_the_weights_are_those_of_experts_of_single_tasks(experts, model, tmp_path):
    alone = save_expert(tmp_path / "alone", experts[0].parents[1] / "base", TASKS[0], 1)
    other = MergedModel(merging([alone, experts[1]]).parts)
    theirs = other.weights(TASKS[0])
    assert all(torch.equal(weight, theirs[name]) for name, weight in model.weights(NAME).items())


def test_which_tasks_an_expert_has_changes_the_digest(merged):
    metadata = load_merged(merged).metadata
    changed = replace(
        metadata,
        tasks_of_several={NAME: (TASKS[0], "null/Other")},
        instructions={TASKS[0]: "", "null/Other": "", TASKS[2]: ""},
    )
    same_words = replace(metadata, instructions=dict.fromkeys(TASKS, ""))
    assert changed.digest != same_words.digest


def test_the_oracle_router_and_instructions_choose_the_expert_of_a_task(model):
    batch = [observation(0, task) for task in TASKS]
    batch = [replace(seen, instruction=model.instructions[seen.task]) for seen in batch]
    for tested in (OracleRouter(), InstructionMatchRouter()):
        assert [one.choice for one in tested.route(batch, model)] == [NAME, NAME, TASKS[2]]


@pytest.mark.parametrize("name", ["calibrated", "nearest-centroid"])
def test_a_fitted_router_has_a_class_for_each_task_and_a_score_for_each_expert(model, merged, name):
    fitted = router(name, stored=load_merged(merged).fitted)
    routed = fitted.route([observation(20, task) for task in TASKS], model)
    assert [one.choice for one in routed] == [NAME, NAME, TASKS[2]]
    assert all(one.scores.keys() == set(model.experts) for one in routed)
    if name == "calibrated":
        assert sum(np.exp(list(routed[0].scores.values()))) == pytest.approx(1.0)


def test_in_records_the_expert_of_the_episodes_task_has_the_tasks_name(model):
    (routed,) = OracleRouter().route([observation(0, TASKS[1])], model)
    assert named_for(routed, TASKS[1], model).choice == TASKS[1]
    assert named_for(routed, TASKS[1], model).scores == {TASKS[1]: 1.0, TASKS[2]: 0.0}
    assert named_for(routed, TASKS[2], model) == routed
    assert named_for(routed, "null/Unknown", model) == routed


def test_experts_act_in_variants_of_their_tasks_and_records_have_the_variants_name(tmp_path):
    variant, own = "libero-plus/robot-goal-7-448", "libero/goal-7-turn-on-stove"
    base = save_base(tmp_path / "base")
    folders = [
        save_expert(tmp_path / "experts" / task.replace("/", "-"), base, task, seed)
        for seed, task in enumerate((own, TASKS[2]))
    ]
    save_merged(tmp_path / "merged", merging(folders, instructions={own: "", TASKS[2]: ""}))
    experts = EXPERTS.load({"folder": str(tmp_path / "experts")})
    merged = MERGED.load({"checkpoint": str(tmp_path / "merged"), "router": "oracle"})
    for policy in (experts, merged):
        check_tasks(policy.spec, [variant])
        with pytest.raises(PolicyError, match="it cannot act in libero-plus/robot-goal-6-447"):
            check_tasks(policy.spec, ["libero-plus/robot-goal-6-447"])
        as_variant, as_own = (policy.act([query(0, task=task)])[0].actions for task in (variant, own))
        np.testing.assert_array_equal(as_variant, as_own)
    assert merged.act([query(1, task=variant)])[0].routing.choice == variant


def test_an_evaluation_counts_an_answer_by_expert(model):
    found = evaluate_routers([OracleRouter()], model, [observation(0, task) for task in TASKS])
    assert [one.routing.choice for one in found.routers[0].answers] == list(TASKS)


def test_policies_act_in_each_task_of_an_expert(experts, merged):
    queries = [query(seed, task=task) for seed, task in enumerate(BOTH)]
    decisions = MERGED.load({"checkpoint": str(merged), "router": "oracle"}).act(queries)
    assert [decision.routing.choice for decision in decisions] == list(BOTH)
    alone = EXPERTS.load({"folder": str(experts[0].parent)}).act(queries)
    assert all(decision.actions.shape == (8, 7) for decision in alone)


def test_a_recipe_merges_experts_of_several_tasks_at_loading(experts, merged):
    options = {
        "checkpoint": str(merged),
        "router": "oracle",
        "experts": str(experts[0].parent),
        "recipe": {"operator": "ta", "lambda_": {NAME: 0.4, TASKS[2]: 0.6}},
    }
    (decision,) = MERGED.load(options).act([query(0, task=BOTH[0])])
    assert decision.routing.choice == BOTH[0]


def refused(match, *folders):
    with one_line_error(MergeError, match):
        merging(folders)


def test_experts_that_share_a_task_or_a_name_are_refused(experts, tmp_path):
    base = experts[0].parents[1] / "base"
    refused(
        "expected one expert per task, got a second one for null/Slow",
        *experts,
        save_expert(tmp_path / "slow", base, TASKS[1], 3),
    )
    twin = save_expert(tmp_path / NAME, base, NAME, 3, several=("null/Other", "null/Odd"))
    refused(f"expected experts of different names, got a second '{NAME}'", experts[0], twin)


def test_statistics_of_each_task_are_refused(experts, tmp_path):
    checkpoint = load_checkpoint(experts[1])
    each = replace(checkpoint.metadata.statistics, by_task={task: some_statistics() for task in BOTH})
    save_checkpoint(
        tmp_path / "each",
        checkpoint.model,
        replace(checkpoint.metadata, statistics=each),
        base=experts[0].parents[1] / "base",
    )
    refused("expected an expert with statistics of all its tasks together, .* got those of each of", tmp_path / "each")


@pytest.mark.parametrize(
    ("tasks", "message"),
    [
        ({"odd": ["null/Reach"]}, "expected tasks of the merged experts, got some of odd"),
        ({NAME: ["null/Reach", "null/Raise"]}, "expected one expert per task, null/Raise has several"),
        ({NAME: ["null/Reach"]}, "instruction of each task, null/Slow has one of them only"),
    ],
)
def test_malformed_metadata_are_refused(merged, tmp_path, tasks, message):
    metadata = json.loads((merged / METADATA_FILE).read_text()) | {"tasks_of_several": tasks}
    (tmp_path / METADATA_FILE).write_text(json.dumps(metadata))
    with one_line_error(PolicyError, message):
        load_merged(tmp_path)


@pytest.mark.nightly
def test_an_expert_is_trained_on_several_tasks_and_merged_by_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for start, task in enumerate(TASKS):
        dataset(tmp_path / "data", task.partition("/")[2], range(20 * start, 20 * start + 20), instruction=task)
    base = save_base(tmp_path / "base")
    save_expert(tmp_path / "experts" / "raise", base, TASKS[2], 2)

    def mergevla(*arguments):
        done = CliRunner().invoke(app, ["mergevla", *arguments])
        assert done.exit_code == 0, done.exception
        return done.output

    mergevla(
        *("finetune", "data/Reach", "data/Slow", "--base", "base", "--out", f"experts/{NAME}"),
        *("--steps", "2", "--batch-size", "4", "--rank", "2"),
    )
    metadata = CheckpointMetadata.read(tmp_path / "experts" / NAME)
    assert (metadata.tasks, metadata.expert) == (BOTH, NAME)
    together = DatasetMixture.open([tmp_path / "data" / "Reach", tmp_path / "data" / "Slow"]).statistics
    assert metadata.statistics == together.together(NAME)
    output = mergevla("merge", "experts", "--out", "merged", "--demonstrations", "data", "--lambda", "auto")
    assert f"{NAME}: lambda" in output
    assert load_merged(tmp_path / "merged").metadata.recipe.lambda_.keys() == {NAME, TASKS[2]}
    mergevla("merge", f"experts/{NAME}", "--out", "alone")
    output = mergevla("routing", "alone", "--seeds", "2", "--demonstrations", "data", "--router", "oracle")
    assert "2 tasks, 2 seeds from 0" in output


def test_a_base_has_no_name_of_an_expert(experts):
    with one_line_error(CheckpointError, "expected an expert with adapters on a base, got none"):
        _ = CheckpointMetadata.read(experts[0].parents[1] / "base").expert
