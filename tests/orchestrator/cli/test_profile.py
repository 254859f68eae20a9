"""`robogauntlet profile` compares the time of an episode with what it could not do without."""

import json

import pytest

SUITE = "name: s\npolicies: [oracle]\ntasks: [{tasks}]\nseeds: {{count: 4}}\n"


@pytest.fixture
def suite(tmp_path):
    def write(*tasks):
        file = tmp_path / "suite.yaml"
        file.write_text(SUITE.format(tasks=", ".join(tasks)))
        return file

    return write


@pytest.mark.simulator
@pytest.mark.ray
def test_the_parts_of_an_episode_add_up_and_the_bound_is_engine_frames_and_answers(run_command, suite):
    (row,) = json.loads(run_command("profile", suite("pybullet/PandaReach-v3"), "--seeds", "2", "--json").out)
    parts = [row[name] for name in ("engine", "control", "frames", "answers", "rest")]
    assert row["total"] == pytest.approx(sum(parts))
    assert row["bound"] == pytest.approx(row["engine"] + row["frames"] + row["answers"])
    assert row["ratio"] == pytest.approx(row["total"] / row["bound"])
    assert 0 < row["engine"] < row["total"]
    assert row["steps"] <= 20


@pytest.mark.ray
def test_the_first_task_of_a_simulator_is_played_unless_tasks_are_named(run_command, suite):
    file = suite("null/Reach", "null/Slow", "null/Raise")
    shown = run_command("profile", file).out.splitlines()
    assert [line.split()[0] for line in shown[1:]] == ["null/Reach"]
    shown = run_command("profile", file, "--task", "null/Reach", "--task", "null/Slow").out.splitlines()
    assert [line.split()[0] for line in shown[1:]] == ["null/Reach", "null/Slow"]
    assert all(line.split()[-1] == "-" for line in shown[1:])  # There is no engine, hence no bound.


@pytest.mark.ray
def test_a_simulator_that_does_not_work_is_one_line(run_command, suite):
    done = run_command("profile", suite("null/Raise"))
    assert (done.code, len(done.err.splitlines())) == (1, 1)
    assert done.err.startswith("robogauntlet: null: ")
    assert "was asked to raise" in done.err


def test_an_unknown_task_is_one_line_before_anything_starts(run_command, suite):
    line = run_command("profile", suite("null/Reach"), "--task", "null/Reech").refusal
    assert "'null/Reech'" in line
    assert "did you mean 'null/Reach'" in line


@pytest.mark.parametrize("content", [b"", b"text", b"PAR1", bytes(range(256))], ids=["empty", "text", "short", "bytes"])
def test_a_file_that_is_no_suite_is_one_line(run_command, tmp_path, content):
    file = tmp_path / "episodes.parquet"
    file.write_bytes(content)
    assert str(file) in run_command("profile", file).refusal


@pytest.mark.parametrize("name", [".", "/"])
def test_a_folder_is_no_suite(run_command, name):
    assert "expected a suite file, this is a directory" in run_command("profile", name).refusal
