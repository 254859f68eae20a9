"""Frames have the size, and chunks the length, that the policies ask for, unless the suite says otherwise."""

import pytest

from robogauntlet.orchestrator.runs.plan import fitted, make_plan
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.suites.episode import RenderProfile
from robogauntlet.suites.selection import SuiteSelection
from tests.errors import one_line_error

SUITE = "name: s\npolicies:\n{policies}\ntasks: [{task}]\nseeds: {{count: 2}}\n"


def asking(name="pi0", **options):
    """An entry of a policy behind a server, of which a plan knows the options only."""
    given = {"address": "ws://127.0.0.1:1", "identity": f"{name}@1", **options}
    return f"  - {{name: {name}, kind: openpi, options: {given}}}"


@pytest.fixture
def planned(suite_file):
    """Plans a suite of these policies: the plan, its lines and its warnings."""

    def plan(*policies, states="", task="null/Reach", **settings):
        path = suite_file(SUITE.format(policies="\n".join(policies), task=task) + states)
        part = SuiteSelection(settings=settings)
        found = make_plan(path, part=part, require_installed=False, start=False)
        return found, list(fitted(found)), list(found.warnings)

    return plan


def views(plan):
    return {(cell.protocol.view.image_size, cell.protocol.replan_every) for cell in plan.cells}


@pytest.mark.parametrize(
    ("options", "size"),
    [
        ({"image_size": 224}, 224),
        ({"image_size": [240, 320]}, 240),
        ({"image_size": [240, 320], "resize": "stretch"}, 320),
        ({}, 96),
    ],
)
def test_frames_are_rendered_in_the_size_that_a_policy_asks_for(planned, options, size):
    plan, lines, warnings = planned(asking(**options))
    assert views(plan) == {(size, 8)}
    assert lines == ([f"s: frames are rendered at {size} px, as policy 'pi0' asks"] if options else [])
    assert warnings == []


def test_a_suite_that_states_a_smaller_size_renders_it_and_is_warned_of(planned):
    plan, lines, warnings = planned(asking(image_size=224), states="image_size: 96\n")
    assert views(plan) == {(96, 8)}
    assert lines == []
    assert warnings == ["frames are rendered at 96 px and enlarged to 224 for policy 'pi0'; set image_size: 224"]


def test_a_suite_that_states_a_larger_size_renders_it_without_a_word(planned):
    plan, lines, warnings = planned(asking(image_size=224), states="image_size: 256\n")
    assert (views(plan), lines, warnings) == ({(256, 8)}, [], [])


def test_policies_that_ask_for_different_sizes_play_pairs_in_the_largest(planned):
    plan, lines, warnings = planned(asking(image_size=224), asking("act", image_size=128), "  - random")
    assert views(plan) == {(224, 8)}
    assert lines == [
        "s: frames are rendered at 224 px, as policy 'pi0' asks; "
        "all policies play the same episodes, 'act' asks for 128"
    ]
    assert warnings == []
    assert len({cell.episode(0).pair_id for cell in plan.cells}) == 1


def test_a_size_that_a_policy_needs_goes_before_one_that_another_asks_for(planned):
    experts = "  - {name: experts, kind: mergevla-experts, options: {folder: 'zoo:experts'}}"
    plan, _, warnings = planned(asking(image_size=224), experts, task="pybullet/PandaReach-v3")
    assert views(plan) == {(96, 8)}
    assert warnings == ["frames are rendered at 96 px and enlarged to 224 for policy 'pi0'; play it in another suite"]


def test_as_many_actions_are_executed_as_a_policy_asks_for(planned):
    plan, lines, warnings = planned(asking(execute=16), "  - random")
    assert views(plan) == {(96, 16)}
    assert lines == ["s: replan_every is 16 for all policies, as policy 'pi0' asks"]
    assert warnings == []
    assert views(planned(asking(execute=5))[0]) == {(96, 8)}


def test_a_suite_that_states_a_smaller_replan_every_keeps_it_and_is_warned_of(planned):
    plan, lines, warnings = planned(asking(execute=16), states="replan_every: 8\n")
    assert (views(plan), lines) == ({(96, 8)}, [])
    assert warnings == [
        "replan_every: 8 is smaller than the 16 actions of a chunk that policy 'pi0' asks to execute; "
        "set replan_every: 16"
    ]


def test_settings_of_the_command_line_are_as_if_the_suite_stated_them(planned):
    settings = {"image_size": 128, "replan_every": 4, "render_profile": RenderProfile.FAST, "workers": 3}
    plan, _, warnings = planned(asking(image_size=224), **settings)
    assert {name: getattr(plan.suite, name) for name in settings} == settings
    assert views(plan) == {(128, 4)}
    assert warnings == ["frames are rendered at 128 px and enlarged to 224 for policy 'pi0'; set image_size: 224"]


def test_settings_that_contradict_the_suite_are_refused_and_workers_replace_its_own(planned):
    states = "image_size: 96\nworkers: 1\n"
    with one_line_error(PlanError, "--image-size 128: expected no other value than that of the suite, which states"):
        planned("  - random", states=states, image_size=128)
    assert planned("  - random", states=states, image_size=96, workers=3)[0].suite.workers == 3
