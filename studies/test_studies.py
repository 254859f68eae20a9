"""What the README of each study shows is printed by its command from the rows that are kept."""

import subprocess

import pytest

from studies.tables import BLOCK, NAMES, STUDIES, readme, with_tables
from tests.test_scripts import commands_of, parsed


@pytest.mark.parametrize("study", NAMES)
def test_the_tables_of_a_readme_are_those_of_the_kept_rows(study):
    text = readme(study).read_text(encoding="utf-8")
    assert with_tables(study, text) == text
    assert {name for _, name in BLOCK.findall(text)} == {path.stem for path in STUDIES.glob(f"{study}/rows/*.json")}


@pytest.mark.parametrize(
    ("script", "verbs"),
    [
        ("merging/training_controls.sh", 325),
        ("robust_experts/robust_experts.sh", 31),
        ("arms/arms.sh", 24),
        ("two_arms/two_arms.sh", 10),
        ("so101/so101.sh", 5),
        ("more_experts/meta_world.sh", 40),
        ("libero/libero.sh", 55),
    ],
)
def test_every_command_of_a_script_is_valid(script, verbs, tmp_path):
    commands = commands_of(STUDIES / script, tmp_path)
    for command in commands:
        parsed(command)
    assert len(commands) == verbs


def test_a_suite_that_libero_lacks_is_refused_first(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as refused:
        commands_of(STUDIES / "libero/libero.sh", tmp_path, "goal", "gaol")
    assert refused.value.stderr == "SUITE: expected spatial, object, goal or 10, got 'gaol'\n"
    assert not (tmp_path / "commands").exists()
