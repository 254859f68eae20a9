"""`robogauntlet mergevla merge`: its files, its output and its errors."""

import pytest
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged
from robogauntlet_mergevla.kinds import MERGED
from tests.mergevla.experts import TASKS, save_base, save_expert, save_experts
from tests.mergevla.training.test_finetune import dataset


@pytest.fixture(scope="module")
def zoo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("zoo")
    save_experts(folder)
    for start, task in enumerate(TASKS):
        dataset(folder / "data", task.partition("/")[2], range(10 * start, 10 * start + 8), instruction=task)
    dataset(folder / "data", "Other", range(3))
    return folder


def merge(*arguments):
    return CliRunner().invoke(app, ["mergevla", "merge", *map(str, arguments)])


def test_experts_are_merged_and_routers_fitted(zoo, tmp_path):
    done = merge(zoo / "experts", "--out", tmp_path / "m", "--demonstrations", zoo / "data", "--operator", "ta")
    assert done.exit_code == 0, done.exception
    for word in ("keep rate", "chance", "cosine", "mask KB", "selfish rate", "distance of experts", *TASKS):
        assert word in done.output
    assert "3 experts merged" in done.output
    assert "fitted routers: calibrated, nearest-centroid" in done.output
    checkpoint = load_merged(tmp_path / "m")
    assert set(checkpoint.metadata.report["observed"]["keep"]) == set(TASKS)
    assert checkpoint.metadata.instructions == {task: task for task in TASKS}
    MERGED.load({"checkpoint": str(tmp_path / "m")})


def test_only_the_routers_that_are_named_are_fitted(zoo, tmp_path):
    done = merge(
        *(zoo / "experts", "--out", tmp_path / "m", "--operator", "ta"),
        *("--demonstrations", zoo / "data", "--router", "nearest-centroid"),
    )
    assert done.exit_code == 0, done.exception
    assert load_merged(tmp_path / "m").metadata.routers == ("nearest-centroid",)


def test_lambda_is_chosen_by_held_out_demonstrations_and_the_losses_are_shown(zoo, tmp_path):
    done = merge(zoo / "experts", "--out", tmp_path / "m", "--demonstrations", zoo / "data", "--lambda", "auto")
    assert done.exit_code == 0, done.exception
    assert "held-out L1" in done.output
    recipe = load_merged(tmp_path / "m").metadata.recipe
    assert recipe.lambda_.keys() == set(TASKS)
    for task, value in recipe.lambda_.items():
        assert f"{task}: lambda {value:g}" in done.output


def test_the_options_determine_the_recipe(zoo, tmp_path):
    folders = sorted((zoo / "experts").iterdir())
    done = merge(
        *(*folders, "--out", tmp_path / "m", "--operator", "dare", "--option", "drop=0.5", "--alpha", 0.5),
        *("--lambda", 0.4, "--lambda", "null/Slow=0.8", "--trunk", "mean", "--keep-blocks", 2, "--select"),
    )
    assert done.exit_code == 0, done.exception
    assert "no router was fitted" in done.output
    recipe = load_merged(tmp_path / "m").metadata.recipe
    assert (recipe.operator, recipe.options, recipe.alpha) == ("dare", {"drop": 0.5}, 0.5)
    assert recipe.lambda_ == {"null/Raise": 0.4, "null/Reach": 0.4, "null/Slow": 0.8}
    assert (recipe.trunk, recipe.kept_blocks, recipe.backbone) == ("mean", 2, "select")


def test_without_weights_the_experts_are_referred_to(zoo, tmp_path):
    done = merge(zoo / "experts", "--out", tmp_path / "m", "--operator", "ta", "--no-weights")
    assert done.exit_code == 0, done.exception
    assert "MB beside base and experts" in done.output
    metadata = load_merged(tmp_path / "m").metadata
    assert {(tmp_path / "m" / place).resolve() for place in metadata.checkpoints.values()} == set(
        (zoo / "experts").iterdir()
    )
    MERGED.load({"checkpoint": str(tmp_path / "m"), "router": "oracle"})


def test_an_earlier_merged_checkpoint_and_leftovers_are_overwritten(zoo, tmp_path):
    for name in (".tmpAb3dEf", "model.safetensors.partial"):
        (tmp_path / name).write_bytes(b"half")
    for operator in ("ta", "emr"):
        assert merge(zoo / "experts", "--out", tmp_path, "--operator", operator).exit_code == 0
    assert load_merged(tmp_path).metadata.recipe.masks == "emr"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{zoo}/experts", "--operator", "tie"], "unknown merge operator 'tie'; did you mean 'ties'?"),
        (["{zoo}/experts", "--masks", "tall"], "masks: expected 'none', 'task', 'emr' or 'signs', got 'tall'"),
        (["{zoo}/experts", "--trunk", "sum"], "trunk: expected 'mean' or 'vectors', got 'sum'"),
        (["{zoo}/experts", "--lambda", "3"], "expected lambda to be a number in (0, 2], got 3.0"),
        (["{zoo}/experts", "--lambda", "x"], "expected --lambda NUMBER or EXPERT=NUMBER, got 'x'"),
        (["{zoo}/experts", "--lambda", "auto"], "expected --demonstrations with --lambda auto, got none"),
        (["{zoo}/experts", "--lambda", "null/Reac=1"], "got 'null/Reac'; did you mean 'null/Reach'?"),
        (
            ["{zoo}/experts", "--keep-blocks", "3"],
            "expected k, the blocks kept per task, to be a whole number in [0, 2]",
        ),
        (["{zoo}/experts", "--option", "drop"], "expected --option NAME=VALUE, got 'drop'"),
        (["{zoo}/experts", "--option", "drop=1"], "operator 'ties' has no option 'drop'"),
        (["{zoo}/experts", "--demonstrations", "{zoo}/none"], "expected a dataset"),
        (["{zoo}/experts", "--router", "calibrated"], "expected --demonstrations with --router, got none"),
        (
            ["{zoo}/experts", "--demonstrations", "{zoo}/data", "--router", "calibratd"],
            ", got 'calibratd'; did you mean 'calibrated'?",
        ),
        (["{zoo}/experts", "--demonstrations", "{zoo}/data/Reach"], "got none of null/Raise"),
        (["{zoo}/base"], "expected an expert with adapters on a base"),
        (["{zoo}/none"], "expected a checkpoint's folder or a hub id"),
        (["{zoo}/data"], "which holds none"),
        (["{zoo}/experts", "{stranger}"], "expected all experts from base"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing_behind(run_command, arguments, message, zoo, tmp_path):
    stranger = save_expert(tmp_path / "stranger", save_base(tmp_path / "base", seed=9), "null/Odd", 5)
    places = [argument.format(zoo=zoo, stranger=stranger) for argument in arguments]
    assert message in run_command("mergevla", "merge", *places, "--out", tmp_path / "out").refusal
    assert not (tmp_path / "out").exists()


def test_a_folder_with_other_files_is_refused(zoo, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    done = merge(zoo / "experts", "--out", tmp_path)
    assert "expected a new folder or that of a merged checkpoint for --out" in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_expert_is_not_overwritten(zoo):
    place = zoo / "experts" / "null-Reach"
    before = (place / "card.json").read_text()
    done = merge(zoo / "experts", "--out", place)
    assert "expected a new folder or that of a merged checkpoint for --out" in str(done.exception)
    assert (place / "card.json").read_text() == before
