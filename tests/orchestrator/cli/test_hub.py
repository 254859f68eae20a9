"""`robogauntlet export --format hub`: a folder that the hub's own library reads, and its push."""

import json
import sys
from types import SimpleNamespace

import pytest

from robogauntlet.results.report import write_report
from robogauntlet.results.run_document import read_run
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, rows, run_folder

hub = pytest.importorskip("huggingface_hub", reason="huggingface_hub is not installed")
CONDITIONS = (Condition(), Condition("noise", 2))


@pytest.fixture
def run(tmp_path):
    plan = cells(("p-1", "p-2"), conditions=CONDITIONS)
    folder = run_folder(tmp_path / "run", document(3, of=plan, rows_hash="abc"), rows(plan, planned=3))
    write_report(folder)
    return folder


def test_the_card_of_a_model_has_the_rates_of_its_policy(run_command, run, tmp_path):
    done = run_command("export", run, "--format", "hub", "--policy", "p-1", "--out", "made/model")
    assert done.code == 0, done.err
    made = tmp_path / "made" / "model"
    assert {path.name for path in made.iterdir()} == {"README.md", "episodes.parquet", "summary.json", "report.html"}
    assert [path.name for path in made.parent.iterdir()] == ["model"]
    card = hub.ModelCard.load(made / "README.md")
    assert (card.data.pipeline_tag, card.data.model_name) == ("robotics", "p-1")
    summary = json.loads((made / "summary.json").read_text())
    own = [cell for cell in summary["cells"] if cell["policy"] == "p-1"]
    splits = ["clean" if cell["axis"] == "clean" else f"{cell['axis']}-{cell['severity']}" for cell in own]
    expected = {(cell["task"], split): cell["tally"]["rate"] for cell, split in zip(own, splits, strict=True)}
    results = [result for result in card.data.eval_results if result.metric_type == "success_rate"]
    assert {(result.dataset_config, result.dataset_split): result.metric_value for result in results} == expected
    assert len(expected) > 1
    intervals = {result.metric_type for result in card.data.eval_results}
    assert intervals == {"success_rate", "success_rate_low", "success_rate_high"}


def test_several_policies_are_a_dataset_of_episodes(run_command, run, tmp_path):
    assert run_command("export", run, "--format", "hub", "--out", "made").code == 0
    card = hub.DatasetCard.load(tmp_path / "made" / "README.md")
    assert card.data.task_categories == ["robotics"]
    (config,) = card.data.to_dict()["configs"]
    assert (tmp_path / "made" / config["data_files"]).is_file()
    assert "model-index" not in card.data.to_dict()
    assert "| p-2" in card.text


def stand_in(has_card, calls):
    """The hub's API without a network."""

    def upload_folder(**options):
        calls.append(options)
        return SimpleNamespace(pr_url="the request" if options["create_pr"] else None, repo_url="the repository")

    return lambda: SimpleNamespace(
        create_repo=lambda name, **options: calls.append((name, options)),
        file_exists=lambda *_, **__: has_card,
        upload_folder=upload_folder,
    )


@pytest.mark.parametrize(("has_card", "where"), [(False, "the repository"), (True, "the request")])
def test_a_push_creates_a_private_repository_and_overwrites_no_card(run_command, run, monkeypatch, has_card, where):
    calls = []
    monkeypatch.setattr(hub, "HfApi", stand_in(has_card, calls))
    done = run_command("export", run, "--format", "hub", "--policy", "p-1", "--out", "made", "--push", "me/p")
    assert (done.code, done.out.splitlines()[-1]) == (0, f"pushed: {where}")
    assert calls[0] == ("me/p", {"repo_type": "model", "private": True, "exist_ok": True})
    assert (calls[1]["repo_id"], str(calls[1]["folder_path"]), calls[1]["create_pr"]) == ("me/p", "made", has_card)


def test_a_push_that_the_hub_refuses_is_one_line_without_its_token(run_command, run, monkeypatch):
    def refuse(*_, **__):
        raise hub.errors.LocalTokenNotFoundError("token s3cr3t")

    monkeypatch.setattr(hub, "HfApi", lambda: SimpleNamespace(create_repo=refuse))
    refusal = run_command("export", run, "--format", "hub", "--out", "made", "--push", "me/p").refusal
    assert refusal.startswith(
        "me/p: the hub did not accept made (LocalTokenNotFoundError); log in with `hf auth login`"
    )


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--format", "hub", "--push", "p"), "--push: expected USER/NAME of letters, digits and . _ -, got 'p'"),
        (("--format", "hub", "--push", "me/p?"), "--push: expected USER/NAME"),
        (("--format", "csv", "--push", "me/p"), "expected --push with --format hub only, got csv"),
        (("--format", "hub", "--policy", "p-3"), "no policy 'p-3'; the run has p-1, p-2"),
        (("--format", "hub", "--out", "run"), "run: expected a new file, this one exists"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(run_command, run, tmp_path, arguments, line):
    before = set(tmp_path.iterdir())
    assert line in run_command("export", run, *arguments).refusal
    assert set(tmp_path.iterdir()) == before


def test_a_missing_library_is_one_line(run_command, run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    refusal = run_command("export", run, "--format", "hub", "--out", "made", "--push", "me/p").refusal
    assert refusal == "--push: huggingface_hub is not installed; install it with: pip install huggingface_hub"
    assert not (tmp_path / "made").exists()


def test_a_report_of_other_rows_is_not_exported(run_command, run):
    summary = run / "summary.json"
    summary.write_text(summary.read_text().replace(str(read_run(run).rows_hash), "other"))
    refusal = run_command("export", run, "--format", "hub", "--out", "made").refusal
    assert refusal.endswith(f"expected a report of its present rows; write it first: robogauntlet report {run}")
