"""Plans of suites, and reasons for what cannot be planned."""

from pathlib import Path

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.orchestrator.registry import find_suite, why_impossible, why_unadjusted
from robogauntlet.orchestrator.runs import suite_policies
from robogauntlet.orchestrator.runs.plan import NO_POLICY, fitted as fitted_lines, make_plan
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.orchestrator.runs.suite_policies import one_of_each_body
from robogauntlet.policies.contract import PolicyInput, PolicySpec
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.loading import SuiteError
from robogauntlet.suites.schema import PolicyEntry
from robogauntlet.suites.selection import SuiteSelection
from tests.errors import one_line_error

SUITE = """name: worded
policies: [zero]
tasks: [{tasks}]
seeds: {{count: 2}}
conditions: [clean, {{axis: instruction, severities: [2, 4]}}]
"""


def test_an_axis_that_some_tasks_do_not_support_is_planned_for_the_others_and_listed(suite_file):
    plan = make_plan(suite_file(SUITE.format(tasks="null/Reach, pybullet/PandaReach-v3")))
    played = {(cell.task, cell.condition.axis) for cell in plan.cells}
    assert ("pybullet/PandaReach-v3", "instruction") in played
    assert ("null/Reach", "clean") in played
    assert ("null/Reach", "instruction") not in played
    assert plan.episodes == (1 + 3) * 2
    (gap,) = plan.unsupported
    assert (gap.axis, gap.task) == ("instruction", "null/Reach")
    assert gap.reason.startswith("suites/paraphrases.py has no paraphrases of")


def test_an_axis_that_no_task_supports_is_refused_with_every_reason(suite_file):
    with pytest.raises(
        SuiteError, match=r"axis 'instruction' is unsupported in null/Reach: suites/paraphrases\.py has no paraphrases"
    ):
        make_plan(suite_file(SUITE.format(tasks="null/Reach")))


def test_a_reason_that_many_tasks_share_is_one_line(suite_file):
    suite = SUITE.replace("axis: instruction, severities: [2, 4]", "variant-name: 1")
    with one_line_error(
        SuiteError, r"axis 'variant-name' is unsupported in null/Reach and 1 more task: the instruction"
    ):
        make_plan(suite_file(suite.format(tasks="null/Reach, null/Slow")))


def test_a_simulator_without_scene_controls_supports_no_axis_of_the_scene():
    assert why_unadjusted(AXES["camera-orbit"], "null/Reach") == (
        "null simulator (no physics) does not let its cameras be adjusted"
    )
    assert why_unadjusted(AXES["noise"], "null/Reach") is None


def test_the_reason_is_that_of_the_tasks_description():
    fixed = [(task, part) for task, card in catalog.task_descriptions().items() for part in card.fixed]
    for task, part in fixed:
        axis = next(axis for axis in AXES.values() if axis.changes == part)
        assert why_unadjusted(axis, task) == catalog.task_descriptions()[task].fixed[part]


def test_a_policy_that_cannot_be_built_is_named_once(suite_file, tmp_path):
    source = "class Policy:\n    def __init__(self):\n        raise OSError('no weights')\n"
    (tmp_path / "broken.py").write_text(source)
    policy = f"{{name: mine, kind: python, options: {{callable: 'broken:Policy', folder: '{tmp_path}'}}}}"
    with one_line_error(SuiteError, r": policy 'mine': building it raised OSError: no weights$"):
        make_plan(suite_file(f"name: s\npolicies: [{policy}]\ntasks: [null/Reach]\nseeds: {{count: 2}}\n"))


UNUSABLE = """name: unusable
policies:
  - oracle
  - python:no_such_module:act
  - {name: mine, kind: openpi, options: {address: "http://host"}}
tasks: [null/Reach]
seeds: {count: 3}
"""


def test_every_unusable_policy_is_named_with_its_line(suite_file):
    with pytest.raises(SuiteError) as refused:
        make_plan(suite_file(UNUSABLE), require_installed=False, start=False)
    assert [
        (problem.line, problem.message.partition(";")[0].partition(" in '")[0]) for problem in refused.value.problems
    ] == [
        (4, "policy 'python-no_such_module-act': expected a module 'no_such_module'"),
        (5, "policy 'mine': address: expected openpi://HOST:PORT, got 'http://host'"),
    ]


EXPERTS = """name: s
policies: [{name: e, kind: mergevla-experts, options: {folder: "zoo:experts"}}]
tasks: [robosuite/Lift]
robots: [UR5e]
seeds: {count: 1}
"""


def test_policies_must_fit_the_tasks_that_a_file_means(suite_file):
    with one_line_error(SuiteError, r"does not fit: .*it cannot act in robosuite/Lift@UR5e;"):
        make_plan(suite_file(EXPERTS))


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ("return np.zeros((8, 6))", r"expected an action chunk of shape \(n, 7\) with n >= 1, got \(8, 6\)"),
        ("pass", r"expected an action chunk, shape \(n, 7\); got None: a return is missing"),
    ],
)
def test_a_function_whose_answer_is_no_action_chunk_is_refused_with_its_line(suite_file, tmp_path, body, found):
    module = f"answers_{len(body)}"
    source = f"import numpy as np\n\n\ndef act(images, proprioception, instruction):\n    {body}\n"
    (tmp_path / f"{module}.py").write_text(source)
    policy = f"{{name: mine, kind: python, options: {{callable: '{module}:act', folder: '{tmp_path}'}}}}"
    with one_line_error(SuiteError, rf":2: policy 'mine' does not fit: {found}$"):
        make_plan(suite_file(f"name: s\npolicies: [{policy}]\ntasks: [null/Reach]\nseeds: {{count: 2}}\n"))


def test_the_hash_of_a_suite_without_policies_is_unknown(suite_file):
    plan = make_plan(
        suite_file("name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 2}\n"), require_installed=False
    )
    assert plan.suite_hash == NO_POLICY


NEEDS = "name: s\nneeds: policy\ntasks: [null/Reach, robosuite/Lift, pybullet/PandaReach-v3]\n"


def fitted(suite_file, *policies):
    suite = suite_file(NEEDS + "seeds: {count: 2}\nimage_size: 224\n")
    plan = make_plan(suite, part=SuiteSelection(policies))
    return plan.suite.tasks, plan.left_out, {cell.protocol.view.image_size for cell in plan.cells}


def test_a_suite_that_needs_a_policy_takes_its_image_size_and_leaves_out_tasks_in_which_it_cannot_act(suite_file):
    played = ("robosuite/Lift", "pybullet/PandaReach-v3")
    assert fitted(suite_file, "zoo:experts") == (played, ("null/Reach",), {96})


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_a_function_is_asked_about_the_first_task_with_one_arm_and_the_first_with_two(order):
    tasks = ("robosuite/Lift", "null/Reach", "robosuite/TwoArmLift@TwoPandas")
    asked = {task.instruction for task in one_of_each_body(tasks[order])}
    known = task_descriptions()
    first = "robosuite/Lift" if order.step is None else "null/Reach"
    assert asked == {known[first].instruction, known[tasks[2]].instruction}


def test_the_suite_of_robosuite_can_be_played_by_a_policy_of_one_arm():
    plan = make_plan(find_suite("robosuite"), part=SuiteSelection(("random",)), require_installed=False)
    assert len(plan.suite.tasks) == 28


def test_several_policies_play_the_tasks_in_which_all_can_act_in_the_images_of_the_suite(suite_file):
    everything = ("null/Reach", "robosuite/Lift", "pybullet/PandaReach-v3")
    assert fitted(suite_file, "zero", "random") == (everything, (), {224})
    assert fitted(suite_file, "zero", "replay") == (everything[1:], everything[:1], {224})
    with pytest.raises(SuiteError, match="the policy was made for 96 px images, the suite renders 224 px"):
        fitted(suite_file, "zero", "zoo:experts")


GATED = NEEDS + "policies: [oracle]\noracle_gate: oracle\nseeds: {count: 2}\nimage_size: 224\n"


def test_the_oracle_gate_of_a_suite_that_needs_a_policy_is_played_beside_it(suite_file):
    plan = make_plan(suite_file(GATED), part=SuiteSelection(("zoo:experts",)))
    assert [policy.name for policy in plan.suite.policies] == ["zoo-experts", "oracle"]
    assert plan.suite.oracle_gate == "oracle"
    assert {cell.protocol.view.image_size for cell in plan.cells} == {96}
    assert plan.left_out == ("null/Reach",)


@pytest.mark.parametrize("policies", [(), ("oracle",)])
def test_the_oracle_gate_alone_is_no_policy_of_a_suite_that_needs_one(suite_file, policies):
    with one_line_error(PlanError, "the suite needs a policy; add --policy with"):
        make_plan(suite_file(GATED), part=SuiteSelection(policies))
    plan = make_plan(suite_file(GATED), part=SuiteSelection(policies), require_installed=False)
    assert (plan.suite_hash, plan.episodes) == (NO_POLICY, 0)


@pytest.mark.parametrize("own", ["needs: policy", "policies: [oracle]"])
def test_a_policy_that_is_added_under_a_name_is_played_alone(suite_file, own):
    entry = PolicyEntry(name="training", kind="random")
    suite = suite_file(f"name: s\n{own}\ntasks: [null/Reach]\nseeds: {{count: 2}}\n")
    assert [cell.policy for cell in make_plan(suite, part=SuiteSelection(added=(entry,))).cells] == ["training"]


def test_what_is_changed_to_fit_a_policy_is_a_line_each(suite_file):
    suite = suite_file(NEEDS + "seeds: {count: 2}\nimage_size: 224\n")
    assert list(fitted_lines(make_plan(suite, part=SuiteSelection(("zoo:experts",))))) == [
        "s: 1 task left out, in which a policy cannot act: null/Reach",
        "s: images of 96 px, which the policy needs, instead of 224 px",
    ]
    assert list(fitted_lines(make_plan(suite, part=SuiteSelection(("zero",))))) == []


@pytest.mark.parametrize("size", [15, 1025])
def test_an_image_size_that_no_suite_can_have_is_refused(suite_file, monkeypatch, size):
    spec = PolicySpec(PolicyInput.OBSERVATION, 1, image_size=size)
    monkeypatch.setattr(suite_policies.policies, "spec", lambda kind, options: spec)
    with pytest.raises(SuiteError, match=f"the policy was made for {size} px images, the suite renders 224 px"):
        fitted(suite_file, "zoo:merged")


def test_a_policy_that_can_act_in_no_task_of_a_suite_is_refused(suite_file):
    suite = suite_file("name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 2}\n")
    with pytest.raises(SuiteError, match="cannot act in null/Reach"):
        make_plan(suite, part=SuiteSelection(("zoo:experts",)))


def test_a_combination_is_planned_for_the_tasks_that_support_all_of_its_axes(suite_file):
    both = SUITE.replace("{{axis: instruction, severities: [2, 4]}}", "{{instruction: 2, noise: 1.5}}")
    plan = make_plan(suite_file(both.format(tasks="null/Reach, pybullet/PandaReach-v3")))
    assert [(cell.task, str(cell.condition)) for cell in plan.cells] == [
        ("null/Reach", "clean"),
        ("pybullet/PandaReach-v3", "clean"),
        ("pybullet/PandaReach-v3", "instruction@2+noise@1.5"),
    ]


def test_a_design_plans_each_of_its_conditions_once(suite_file):
    grid = "conditions: [clean, noise@2]\ndesign: {{kind: grid, axes: [noise, action-delay], severities: [2, 4]}}"
    text = SUITE.replace("conditions: [clean, {{axis: instruction, severities: [2, 4]}}]", grid)
    plan = make_plan(suite_file(text.format(tasks="null/Reach")))
    assert len(plan.cells) == 3 * 3
    assert [str(cell.condition) for cell in plan.cells[:2]] == ["clean", "noise@2"]


def test_a_design_needs_tasks_that_support_all_of_its_axes(suite_file):
    design = "conditions: [clean]\ndesign: {{kind: grid, axes: [noise, instruction], severities: [2]}}"
    text = SUITE.replace("conditions: [clean, {{axis: instruction, severities: [2, 4]}}]", design)
    with one_line_error(SuiteError, r"axis 'instruction' is unsupported in null/Reach"):
        make_plan(suite_file(text.format(tasks="null/Reach, pybullet/PandaReach-v3")))


def test_a_task_cannot_have_a_condition_with_an_axis_that_it_lacks():
    combined = Condition("noise@2+table@1.5", 1)
    assert why_impossible(combined, "null/Reach").endswith("does not let its table be adjusted")
    assert why_impossible(combined, "pybullet/PandaReach-v3") is None


def test_a_shipped_suite_is_found_beside_a_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mergevla").mkdir()
    assert find_suite("mergevla").name == "mergevla.yaml"
    (tmp_path / "own").mkdir()
    assert find_suite("own") == Path("own")
