"""Mistakes at the command line are one line each, before anything starts."""

import pytest

SUITE = "name: s\npolicies: [random]\ntasks: [null/Reach]\nseeds: {count: 1}\n"


@pytest.mark.parametrize(
    ("typed", "line"),
    [
        (
            "run suite.yaml --address 127.0.0.1:1",
            "--address 127.0.0.1:1: expected the head of a Ray cluster, nothing answers there: Connection refused",
        ),
        *(
            (
                f"run suite.yaml --address {address}",
                f"--address {address}: expected HOST:PORT of a Ray cluster's head, such as 10.0.0.7:6379, or auto",
            )
            for address in ("head", "head:port", "head:0", "ray://head:10001")
        ),
        ("plan suite.yaml --out suite.yaml", "suite.yaml: expected a run folder, this is a file"),
        ("axes sheet noise --out no/x.png", "--out: expected a file in an existing folder, got 'no/x.png'"),
    ],
)
def test_a_mistake_is_one_line_before_anything_starts(run_command, tmp_path, typed, line):
    (tmp_path / "suite.yaml").write_text(SUITE)
    assert run_command(*typed.split()).refusal == line
    assert [path.name for path in tmp_path.iterdir()] == ["suite.yaml"]


def test_demonstrations_are_not_written_into_a_run_folder(run_command, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").touch()
    line = run_command("policies", "demonstrate", "null/Reach", "--out", "run").refusal
    assert line == "run: expected a folder that is not a run folder; give one with --out"
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.json"]


@pytest.mark.parametrize("wrong", ["--seed=-1", "--image-size=0", "--image-size=100000"])
def test_a_sheet_needs_a_valid_seed_and_image_size(run_command, wrong):
    result = run_command("axes", "sheet", "noise", "--out", "x.png", "--task", "null/Reach", wrong)
    assert result.code == 2
    assert f"Invalid value for '{wrong.partition('=')[0]}'" in result.err
