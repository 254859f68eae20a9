"""Choice of lambda by held-out demonstrations."""

import pytest

from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet_mergevla.checkpoints.merge_experts import read_experts
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture, HeldOut
from robogauntlet_mergevla.training.lambda_selection import choose_lambdas, experts_l1, held_out_l1
from robogauntlet_mergevla.training.training_checkpoint import TrainingError
from tests.mergevla.experts import INSTRUCTIONS, TASKS, merging, save_experts
from tests.mergevla.training.test_finetune import dataset


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("selection")
    folders = save_experts(folder / "zoo")
    shown = [dataset(folder, task.partition("/")[2]) for task in TASKS]
    return read_experts(folders), DatasetMixture([Demonstrations(place) for place in shown]), folders


def test_each_task_gets_the_lambda_with_which_its_held_out_loss_is_least(made):
    experts, pool, _ = made
    recipe, table = choose_lambdas(experts, Recipe(), pool, INSTRUCTIONS, among=(0.2, 0.6, 1.5))
    assert table.keys() == set(TASKS)
    for task, losses in table.items():
        assert losses[recipe.lambda_[task]] == min(losses.values())


def test_the_table_has_the_losses_of_the_merged_model(made):
    experts, pool, folders = made
    _, table = choose_lambdas(experts, Recipe(), pool, INSTRUCTIONS, among=(0.6,))
    parts = merging(folders).parts
    again = held_out_l1(MergedModel(parts).model, parts.statistics, pool, part=HeldOut.CHOICE)
    assert again == pytest.approx({task: losses[0.6] for task, losses in table.items()})


def test_a_single_expert_has_the_loss_of_its_network(made):
    from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_folded

    experts, pool, folders = made
    alone = load_folded(folders[0])
    expected = held_out_l1(lambda _: alone.model, alone.metadata.statistics, pool, TASKS[:1])
    assert experts_l1(experts, pool, INSTRUCTIONS)[TASKS[0]] == pytest.approx(expected[TASKS[0]], abs=1e-6)


def test_lambda_is_chosen_on_other_episodes_than_those_that_score_it(tmp_path):
    pool = DatasetMixture([Demonstrations(dataset(tmp_path, "Reach", range(40)))])
    states = {
        part: {row.tobytes() for batch in pool.held_out(16, chunk_length=8, part=part) for row in batch.states}
        for part in HeldOut
    }
    assert states[HeldOut.CHOICE]
    assert states[HeldOut.SCORE]
    assert not states[HeldOut.CHOICE] & states[HeldOut.SCORE]
    assert states[HeldOut.CHOICE] | states[HeldOut.SCORE] == states[HeldOut.ALL]


def test_a_single_held_out_episode_cannot_score_what_is_chosen_on_it(made):
    _, pool, folders = made
    parts = merging(folders).parts
    with pytest.raises(TrainingError, match="to score, beside those that lambda is chosen on, got too few"):
        held_out_l1(MergedModel(parts).model, parts.statistics, pool, part=HeldOut.SCORE)


def test_without_task_masks_there_is_no_lambda_to_choose(made):
    experts, pool, _ = made
    with pytest.raises(TrainingError, match="expected task masks, whose lambda can be chosen, got masks 'none'"):
        choose_lambdas(experts, Recipe(masks="none"), pool)
