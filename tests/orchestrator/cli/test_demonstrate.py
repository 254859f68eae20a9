"""Demonstrations do not go into the folder of a run."""


def test_demonstrations_are_not_written_into_a_run_folder(run_command, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").touch()
    line = run_command("new", "demonstrations", "null/Reach", "--out", "run").refusal
    assert line == "run: expected a folder that is not a run folder; give one with --out"
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.json"]
