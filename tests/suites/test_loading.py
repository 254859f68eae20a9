"""Suite files: all mistakes are reported at once, with their lines and the nearest names."""

import textwrap
from contextlib import nullcontext

import pytest

from robogauntlet.suites.episode import Condition, RenderProfile
from robogauntlet.suites.loading import SuiteError, load_suite
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry

NAMES = Registry(
    tasks={
        "maniskill/PushCube-v1": KnownTask(80),
        "maniskill/PullCube-v1": KnownTask(80),
        "robosuite/Lift": KnownTask(120),
        "robosuite/Door": KnownTask(300),
    },
    policies={
        "oracle": KnownPolicy(),
        "random": KnownPolicy(),
        "learned": KnownPolicy(options=frozenset({"checkpoint"}), tasks=frozenset({"robosuite/Lift"})),
    },
    axes={"light": 5, "blind": 1},
)
SOUND = """
name: a-suite
policies: [oracle]
tasks: [robosuite/Lift]
seeds: {start: 3, count: 4}
"""


@pytest.fixture
def problems(tmp_path):
    """The problems of a suite text, as `line: message`."""

    def read(text):
        with pytest.raises(SuiteError) as caught:
            load(tmp_path, text)
        for problem in caught.value.problems:
            assert problem.path == str(tmp_path / "suite.yaml")
            assert "\n" not in str(problem)
        return [f"{problem.line}: {problem.message}" for problem in caught.value.problems]

    return read


def load(tmp_path, text):
    path = tmp_path / "suite.yaml"
    path.write_text(textwrap.dedent(text).lstrip("\n"), encoding="utf-8")
    return load_suite(path, NAMES)


ROBOTS = Registry(
    tasks={
        "robosuite/Lift": KnownTask(80, robot="Panda"),
        "robosuite/Door": KnownTask(180, robot="Panda"),
        "robosuite/Can": KnownTask(200, robot="Panda"),
        "robosuite/Lift@UR5e": KnownTask(120, robot="UR5e"),
        "robosuite/Door@UR5e": KnownTask(270, robot="UR5e"),
        "maniskill/PushCube-v1": KnownTask(80),
    },
    policies=NAMES.policies,
)


def with_robots(tmp_path, tasks, robots):
    (path := tmp_path / "suite.yaml").write_text(SOUND.replace("[robosuite/Lift]", f"{tasks}\nrobots: {robots}"))
    return load_suite(path, ROBOTS)


def test_each_task_is_played_by_each_of_the_robots(tmp_path):
    suite = with_robots(tmp_path, "[robosuite/Lift, robosuite/Door]", "[Panda, UR5e]")
    lift, door = "robosuite/Lift", "robosuite/Door"
    assert suite.tasks == (lift, f"{lift}@UR5e", door, f"{door}@UR5e")


def test_a_suite_with_robots_plays_what_one_with_their_tasks_plays(tmp_path):
    suite = with_robots(tmp_path, "[robosuite/Lift]", "[UR5e, Panda]")
    assert suite == with_robots(tmp_path, "['robosuite/Lift@UR5e', robosuite/Lift]", "[]")


@pytest.mark.parametrize(
    ("tasks", "robots", "message"),
    [
        ("[robosuite/Lift]", "[Panda, UR5]", "'UR5' cannot play 'robosuite/Lift'; did you mean 'UR5e'?"),
        ("[robosuite/Lift]", "[Panda, Atlas]", "'Atlas' cannot play 'robosuite/Lift'; known: Panda, UR5e"),
        ("['robosuite/*']", "[UR5e]", "'UR5e' cannot play 'robosuite/Can'; known: Panda"),
        ("[maniskill/PushCube-v1]", "[UR5e]", "'UR5e' cannot play 'maniskill/PushCube-v1'; it has one robot only"),
        (
            "['robosuite/Lift@UR5e']",
            "[Panda]",
            "expected tasks that name no robot beside robots, got 'robosuite/Lift@UR5e'",
        ),
        ("[robosuite/Lift]", "[UR5e, UR5e]", "duplicate task 'robosuite/Lift@UR5e'"),
    ],
)
def test_a_robot_that_cannot_play_is_refused_in_one_line(tmp_path, tasks, robots, message):
    with pytest.raises(SuiteError) as refused:
        with_robots(tmp_path, tasks, robots)
    assert [problem.message for problem in refused.value.problems] == [message]


def test_a_valid_suite_has_the_documented_defaults(tmp_path):
    suite = load(tmp_path, SOUND)
    assert suite.all_conditions() == [Condition()]
    assert list(suite.seeds) == [3, 4, 5, 6]
    assert suite.render_profile is RenderProfile.STANDARD
    assert (suite.replan_every, suite.image_size, suite.cameras) == (8, 96, ("third_person", "wrist"))
    assert suite.worker_count("robosuite") == 1


def test_a_pattern_stands_for_all_tasks_that_match(tmp_path):
    suite = load(tmp_path, SOUND.replace("robosuite/Lift", '"robosuite/*"'))
    assert suite.tasks == ("robosuite/Lift", "robosuite/Door")


def test_a_policy_can_be_given_a_name_and_options(tmp_path):
    suite = load(tmp_path, SOUND.replace("[oracle]", "[{name: mine, kind: learned, options: {checkpoint: x}}]"))
    assert (suite.policies[0].name, suite.policies[0].kind) == ("mine", "learned")
    assert suite.policies[0].options == {"checkpoint": "x"}


def test_conditions_have_axes_and_severities(tmp_path):
    suite = load(tmp_path, SOUND + "conditions: [clean, {axis: light, severities: [2, 4]}]\n")
    assert [str(c) for c in suite.all_conditions()] == ["clean", "light@2", "light@4"]


def test_a_condition_that_is_only_named_is_clean_or_a_control(problems):
    assert problems(SOUND + "conditions: [clean, light, blnd]\n") == [
        "5: expected severities above 0 for 'light', as {axis: light, severities: [2, 4]}",
        "5: unknown condition 'blnd'; did you mean 'blind'?",
    ]


def test_controls_are_conditions_of_their_own_name(tmp_path):
    suite = load(tmp_path, SOUND + "conditions: [clean, blind]\n")
    assert [str(condition) for condition in suite.all_conditions()] == ["clean", "blind"]


def test_every_mistake_is_reported_at_once_with_its_line(problems):
    assert problems(
        """
        name: a-suite
        policies: [oracel]
        tasks:
          - maniskill/PushCub-v1
          - robosuit/Lift
        conditions: [{axis: lihgt, severities: [1]}]
        cameras: [third_persn]
        seeds: {count: 4}
        workers: {robosuit: 2}
        """
    ) == [
        "2: unknown policy 'oracel'; did you mean 'oracle'?",
        "4: unknown task 'maniskill/PushCub-v1'; did you mean 'maniskill/PushCube-v1'?",
        "5: unknown simulator 'robosuit' in 'robosuit/Lift'; did you mean 'robosuite'?",
        "6: unknown condition 'lihgt'; did you mean 'light'?",
        "6: no clean condition to compare the perturbed ones with; add clean",
        "7: unknown camera 'third_persn'; did you mean 'third_person'?",
        "9: unknown simulator 'robosuit'; did you mean 'robosuite'?",
    ]


def test_every_mistake_of_form_is_reported_before_names_are_checked(problems):
    assert problems(
        """
        nmae: a-suite
        policies:
          - {name: "not ok", kind: oracle}
          - oracel
        tasks: [5, robosuite/Lfit]
        conditions: [{axis: light, severities: [9]}, {axis: lihgt, severities: [1]}]
        image_size: large
        """
    ) == [
        "1: missing key 'name'",
        "1: missing key 'seeds'",
        "1: unknown key 'nmae'; did you mean 'name'?",
        "3: policies.1.name: expected letters, digits, '.', '_' or '-', starting with a letter or digit; found 'not ok'",
        "5: tasks.1: expected a valid string, found a whole number (5)",
        "6: conditions.1.severities.1: expected a value less than or equal to 5, found 9",
        "7: image_size: expected a valid integer, found text ('large')",
    ]


def test_a_suite_lists_policies_or_needs_one(problems, tmp_path):
    free = SOUND.replace("policies: [oracle]", "needs: policy")
    assert load(tmp_path, free).policies == ()
    assert problems(free.replace("robosuite/Lift", "robosuite/Lfit")) == [
        "3: unknown task 'robosuite/Lfit'; did you mean 'robosuite/Lift'?"
    ]
    assert problems(SOUND + "needs: policy\n") == [
        "2: 'oracle': expected none but those of oracle_gate and no_skill_baselines beside needs: policy"
    ]
    assert load(tmp_path, SOUND + "needs: policy\noracle_gate: oracle\n").reference_policies == ("oracle",)
    assert problems(SOUND.replace("policies: [oracle]\n", "")) == ["1: missing key 'policies'"]
    assert problems(SOUND.replace("policies: [oracle]", "needs: policies")) == [
        "1: missing key 'policies'",
        "2: needs: expected 'policy', found 'policies'",
    ]


def test_the_message_for_an_unknown_task_names_those_of_its_simulator(problems):
    assert problems(SOUND.replace("robosuite/Lift", "robosuite/PushCube-v1")) == [
        "3: unknown task 'robosuite/PushCube-v1'; did you mean 'robosuite/Lift'?"
    ]


@pytest.mark.parametrize(
    ("seeds", "refused"),
    [
        ("{count: 50}", None),
        ("{start: 49, count: 1}", None),
        ("{start: 1000000, count: 60}", None),
        ("{count: 51}", "seeds 0 to 49, since it has 50 stored states, which further seeds repeat; got seeds 0 to 50"),
        (
            "{start: 30, count: 40}",
            "seeds 0 to 49, since it has 50 stored states, which further seeds repeat; got seeds 30 to 69",
        ),
        (
            "{start: 999999, count: 2}",
            "seeds 0 to 49, since it has 50 stored states, which further seeds repeat; got seeds 999999 to 1000000",
        ),
    ],
)
def test_seeds_that_would_repeat_stored_states_are_refused(tmp_path, seeds, refused):
    path = tmp_path / "s.yaml"
    path.write_text(f"name: s\npolicies: [oracle]\ntasks: [a/*]\nseeds: {seeds}\n")
    names = Registry({"a/Free": KnownTask(50), "a/Stored": KnownTask(50, start_states=50)}, NAMES.policies, {})
    with nullcontext() if refused is None else pytest.raises(SuiteError, match=f": a/Stored: expected {refused}$"):
        load_suite(path, names)


def test_seeds_that_an_adaptive_suite_may_reach_would_repeat_stored_states(tmp_path):
    names = Registry({"a/Stored": KnownTask(50, start_states=1)}, NAMES.policies, {})
    path = tmp_path / "s.yaml"
    compare = "compare: {baseline: oracle, others: [random]}\nadaptive: {max_seeds: 2, round: 1}\n"
    path.write_text(f"name: s\npolicies: [oracle, random]\ntasks: [a/Stored]\nseeds: {{count: 1}}\n{compare}")
    with pytest.raises(SuiteError, match="a/Stored: expected seed 0 alone, since it has one stored state"):
        load_suite(path, names)


def test_internal_tasks_and_policies_are_not_suggested(tmp_path):
    names = Registry({"a/One": KnownTask(50), "null/One": KnownTask(50, internal=True)}, NAMES.policies, {})
    path = tmp_path / "s.yaml"
    path.write_text("name: s\npolicies: [oracle]\ntasks: [null/One]\nseeds: {count: 1}\n")
    assert load_suite(path, names).tasks == ("null/One",)
    path.write_text(path.read_text().replace("null/One", "nul/One"))
    with pytest.raises(SuiteError, match=r"unknown simulator 'nul' in 'nul/One'; known: a$"):
        load_suite(path, names)


def test_a_task_that_a_pattern_stands_for_already_is_a_duplicate(problems):
    twice = SOUND.replace("[robosuite/Lift]", "[robosuite/Lift, 'robosuite/*']")
    assert problems(twice) == ["3: duplicate task 'robosuite/Lift'"]


def test_a_policy_that_cannot_act_in_a_task_is_refused(problems):
    text = SOUND.replace("oracle", "learned").replace("robosuite/Lift", "robosuite/Door")
    assert problems(text) == ["3: policy 'learned' cannot act in 'robosuite/Door'"]


def test_object_tags_are_refused_and_not_constructed(problems, tmp_path):
    target = tmp_path / "made"
    (found,) = problems(f"name: !!python/object/apply:os.mkdir ['{target}']\n")
    assert found.endswith("without tags, found the tag 'tag:yaml.org,2002:python/object/apply:os.mkdir'")
    assert not target.exists()


def test_text_that_is_not_yaml_is_refused_with_its_line(problems):
    (found,) = problems("name: a\ntasks: [a, b\n")
    assert found.startswith("3: not YAML: ")


MERGING = """
name: a-suite
policies: [oracle, random, {name: merged, kind: random}, {name: merged-2, kind: random}]
tasks: [robosuite/Lift]
seeds: {count: 4}
merging:
  expert: oracle
  oracle_routed: random
  routed: [merged, merged-2]
"""


def test_a_suite_can_say_which_policies_the_report_compares(tmp_path):
    merging = load(tmp_path, MERGING).merging
    assert (merging.expert, merging.oracle_routed, merging.routed) == ("oracle", "random", ("merged", "merged-2"))
    assert load(tmp_path, SOUND).merging is None


@pytest.mark.parametrize(
    ("right", "wrong", "problem"),
    [
        ("expert: oracle", "expert: oracel", "6: merging names no policy of this suite: 'oracel'; did you mean 'oracle'?"),
        ("merged-2]\n", "mergd]\n", "8: merging names no policy of this suite: 'mergd'; did you mean 'merged'?"),
        (": random\n  r", ": oracle\n  r", "7: merging names policy 'oracle' twice; each side is another policy"),
        ("  oracle_routed: random\n", "", "5: missing key 'oracle_routed'"),
        ("oracle_routed", "oracle_route", "7: unknown key 'oracle_route'; did you mean 'oracle_routed'?"),
        ("routed: [merged, merged-2]", "routed: []", "8: merging.routed: expected at least one entry, found an empty list"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_merging_block_is_named_with_its_line(problems, right, wrong, problem):
    assert MERGING.count(right) == 1
    assert problem in problems(MERGING.replace(right, wrong))
