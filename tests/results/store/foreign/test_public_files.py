"""Result files that others published are imported with their counts, or refused in one line (tests/data/README.md)."""

from collections import Counter

import pytest

from robogauntlet.results import api
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.foreign.files import read_files
from robogauntlet.results.store.foreign.run import import_results
from robogauntlet.results.store.foreign.trials import BadResults
from tests import ROOT
from tests.errors import one_line_error

DATA = ROOT / "tests" / "data" / "public_results"
BOOK = "LIBEROBenchmark_libero_10/pick up the book and place it in the back compartment of the caddy"
STOVE = "LIBEROBenchmark_libero_10/turn on the stove and put the moka pot on it"
SQUARE, ROUND = "trials/Square stick 3.0 x 22 cm", "trials/Held-out object: round stick 3.0 x 24 cm"
DEX3, RETARGETED, TUNED = ("Original-Dex-hand-task-Dex3", "Brainco-retargeting-only", "Brainco-retargeting-fine-tuning")
ASSEMBLY, MICROWAVE = "trials/Two pair assembly", "trials/bimanual_microwave_cook"
AS_HANDOVER = {"stage_name": "policy", "configuration": "task"}
AS_AGENTS = {"agent": "policy", "perturbation": "task"}
AS_ASSEMBLY = {"model": "policy", "task_family": "task", "outcome": "success"}


@pytest.fixture
def read(tmp_path):
    """Reads public files, after their user renamed columns."""

    def call(names, renamed, **options):
        files = [tmp_path / name for name in names]
        for file in files:
            header, _, rest = (DATA / file.name).read_text().partition("\n")
            file.write_text(",".join(renamed.get(column, column) for column in header.split(",")) + "\n" + rest)
        return read_files(files, **options)

    return call


@pytest.mark.parametrize(
    ("names", "renamed", "options", "paired", "counts"),
    [
        pytest.param(
            ["lerobot_libero_10.json"],
            {},
            {"policies": ["smolvla"]},
            False,
            {("smolvla", "libero_10/0"): (3, 10), ("smolvla", "libero_10/4"): (2, 10)},
            id="several tasks, two keys that newer versions of LeRobot add",
        ),
        pytest.param(
            ["lerobot_pusht.json"],
            {},
            {"policies": ["diffusion"], "task": "pusht/PushT-v0"},
            True,
            {("diffusion", "pusht/PushT-v0"): (2, 3)},
            id="one task with seeds",
        ),
        pytest.param(
            ["vla_eval_pi0.json", "vla_eval_xvla.json"],
            {},
            {"policies": ["pi0", "xvla"]},
            False,
            {("pi0", BOOK): (3, 4), ("pi0", STOVE): (1, 1), ("xvla", BOOK): (3, 5), ("xvla", STOVE): (3, 3)},
            id="vla-eval 0.0, whose episodes have no metrics, and ids that are texts",
        ),
        pytest.param(
            ["handover.csv"],
            AS_HANDOVER,
            {},
            False,
            {(DEX3, SQUARE): (2, 3), (DEX3, ROUND): (1, 2), (RETARGETED, SQUARE): (0, 1), (TUNED, SQUARE): (1, 2)},
            id="1 and 0, empty values",
        ),
        pytest.param(
            ["controllers.csv"],
            {"provider": "policy"},
            {"task": "pick"},
            True,
            {("deepseek", "trials/pick"): (0, 2), ("jev", "trials/pick"): (2, 2), ("rules", "trials/pick"): (2, 2)},
            id="True and False, no task",
        ),
        pytest.param(
            ["agents.csv"],
            AS_AGENTS,
            {},
            True,
            {
                (agent, f"trials/{task}"): (won, of)
                for task, of, counts in (("grasp_slip", 2, (0, 2, 2)), ("stale_observation", 1, (1, 1, 1)))
                for agent, won in zip(("open_loop", "reactive_replan", "self_healing"), counts, strict=True)
            },
            id="seeds of twenty digits",
        ),
        pytest.param(
            ["assembly.csv"],
            AS_ASSEMBLY,
            {},
            False,
            {
                ("GPT-6-Astra", ASSEMBLY): (3, 3),
                ("GPT-5.6-Terra", ASSEMBLY): (1, 4),
                ("Claude-Fable-5.1", ASSEMBLY): (0, 1),
            },
            id="success and failure, values in quotes",
        ),
        pytest.param(
            ["microwave.csv"],
            {"role": "policy", "seed": "training", "initial_sha256": "state"},
            {},
            True,
            {("retry", MICROWAVE): (1, 4)},
            id="start states named by their hash",
        ),
    ],
)
def test_a_public_file_is_imported_with_its_counts(read, tmp_path, names, renamed, options, paired, counts):
    found = read(names, renamed, **options)
    assert found.paired == paired
    folder, _ = import_results(found, [], tmp_path / "runs", suite="public")
    rows = api.open_run(folder).episodes()
    cells = list(zip(rows["policy"], rows["task"], strict=True))
    won = Counter(cell for cell, status in zip(cells, rows["status"], strict=True) if status == "success")
    assert {cell: (won[cell], of) for cell, of in Counter(cells).items()} == counts


@pytest.mark.parametrize(
    ("name", "renamed", "options", "message"),
    [
        ("lerobot_under_a_name.json", {}, {"policies": ["smolvla"]}, "this is something else, with eval_results_400"),
        ("handover.csv", {}, {}, "expected a column policy or --policy NAME, got stage, stage_name, configuration, tr"),
        ("controllers.csv", {"provider": "policy"}, {}, "expected a column task or --task NAME, got id, policy, seed"),
        ("assembly.csv", {"model": "policy", "task_family": "task"}, {}, "expected a column success, got slot_id, tab"),
    ],
)
def test_a_public_file_of_another_form_is_refused(read, name, renamed, options, message):
    with one_line_error(RunError, message):
        read([name], renamed, **options)


def test_episodes_that_several_training_seeds_number_alike_are_refused(read, tmp_path):
    found = read(["microwave.csv"], {"role": "policy", "seed": "training", "episode": "trial"})
    with one_line_error(BadResults, f"trial 0 of retry in {MICROWAVE} is there twice$"):
        import_results(found, [], tmp_path / "runs", suite="public")
