"""A benchmark of vla-evaluation-harness is played as its own runner plays it, by its class."""

import asyncio
import re
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError, SimulatorUnavailable, TaskUnavailable
from robogauntlet.adapters.vla_eval import Part, declare
from robogauntlet.adapters.vla_eval.listing import listing
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.checked_task import VIEW, CheckedTask
from robogauntlet.orchestrator.kit.finding import Level
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import PolicyInput, PolicyMismatch, PolicySpec, check_fit
from robogauntlet.suites.episode import CAMERAS, Condition, Episode, Protocol, View
from tests.errors import one_line_error

toys = pytest.importorskip("tests.adapters.toy_benchmarks")

TOYS, VIEW_64 = "tests.adapters.toy_benchmarks", View(CAMERAS[:1], 64)
ACTION = {"move": Part(2, -1.0, 1.0), "gripper": Part(1, -1.0, 1.0, still=-1.0)}
SENTENCES = {"push left": "push left", "push right": "push right"}


def toy(name="Pushes", **changes):
    given = {"tasks": SENTENCES, "action": ACTION, "state": {"places": 2}, "cameras": {"third_person": "front"}}
    given |= {"horizon": 40, "control_hz": 10.0, "start_states": 50}
    return declare("toys", "Toys", f"{TOYS}:{name}", **(given | changes))


@pytest.fixture
def known(monkeypatch):
    """Makes a simulator one that the catalog knows."""

    def know(simulator):
        monkeypatch.setattr(catalog, "simulators", lambda: {simulator.name: simulator})
        return simulator

    return know


def episode(policy="random", seed=3, task="toys/push-right", condition=None, horizon=40):
    protocol = Protocol(horizon, 4, VIEW_64)
    return Episode(policy, policy, task, seed, protocol, condition or Condition())


def test_a_task_has_the_names_of_the_class_and_is_planned_without_it():
    simulator = declare(
        "absent",
        "Absent",
        "no_such_package:Benchmark",
        **{"tasks": {"Grasp easy": "", "Hard lunar (2)": "land"}, "action": {"action": Part(2)}},
        **{"cameras": {"third_person": "viewport"}, "horizon": 9, "control_hz": 10.0, "modules": ("no_such_package",)},
    )
    assert {name: task.instruction for name, task in simulator.tasks.items()} == {
        "Grasp-easy": "Grasp easy",
        "Hard-lunar-2": "land",
    }
    assert simulator.tasks["Grasp-easy"].body.action_names == ("action_1", "action_2")
    assert simulator.modules == ("vla_eval", "no_such_package")
    assert "no module no_such_package" in catalog.missing_reason(simulator)


def test_an_episode_has_the_outcome_and_rewards_that_the_harness_has(known):
    known(toy())
    with closing(toy().open("push-right", VIEW_64)) as simulation:
        simulation.reset(3)
        place, actions = simulation.observe().proprioception, []
        while len(actions) < 40 and not simulation._outcome.terminated:
            actions.append(np.array([0.4, 0.1, 1.0]))
            simulation.step(actions[-1])
        reached = simulation.observe().proprioception
    theirs = toys.Pushes()
    np.random.seed(3)
    asyncio.run(theirs.start_episode({**theirs.get_tasks()[1], "episode_idx": 3}))
    assert np.array_equal(theirs.place, place)
    for number, action in enumerate(actions, start=1):
        asyncio.run(theirs.apply_action({"actions": action}))
        assert asyncio.run(theirs.is_done()) == (number == len(actions))
    assert asyncio.run(theirs.get_result())["success"]
    assert np.array_equal(theirs.place, reached)


def test_a_whole_image_is_shown_at_the_size_that_is_asked_for_and_at_its_own_unchanged():
    with closing(toy(arguments={"size": (48, 48)}).open("push-left", View(CAMERAS[:1], 48))) as simulation:
        assert np.array_equal(simulation.observe().images["third_person"], simulation._seen["images"]["front"])
        assert simulation.picture().shape == (256, 256, 3)
    with closing(toy().open("push-left", VIEW_64)) as simulation:
        image = simulation.observe().images["third_person"]
        assert np.array_equal(image[8:56], simulation._seen["images"]["front"])
        assert not image[:8].any()
        assert not image[56:].any()


@pytest.mark.parametrize("name", ["Pushes", "HoldsAnEnvironment"])
def test_it_keeps_the_contract_and_equal_seeds_are_equal_episodes(known, name):
    simulator = known(toy(name))
    with closing(CheckedTask(simulator, "push-left", replace(VIEW, cameras=CAMERAS[:1]))) as subject:
        apart = {"seeds-new-process", "memory", "pace", "step-draws-nothing"}
        found = [finding for check in CHECKS.values() if check.name not in apart for finding in check.run(subject)]
    assert [str(finding) for finding in found if finding.level is Level.FAILED] == []
    assert {finding.topic for finding in found if finding.level is Level.OK} >= {"seeds", "two-at-once", "observation"}


def test_global_generators_are_as_they_were():
    np.random.seed(5)
    expected = np.random.random(2)
    np.random.seed(5)
    with closing(toy().open("push-left", VIEW_64)) as simulation:
        simulation.reset(1)
        simulation.step(np.array([0.1, 0.0, 1.0]))
    assert np.array_equal(np.random.random(2), expected)


def test_axes_of_images_actions_and_words_apply(known):
    simulator = known(toy())
    with closing(simulator.open("push-right", VIEW_64)) as simulation:
        clean = rollout(simulation, load("random", {}), episode())
        assert clean.status in ("success", "failure")
        for axis, policy in (("noise", "untrained"), ("action-delay", "random"), ("blank-instruction", "untrained")):
            severity = 1 if axis == "blank-instruction" else 3
            row = rollout(simulation, load(policy, {}), episode(policy, condition=Condition(axis, severity)))
            assert row.status in ("success", "failure"), axis


def test_a_class_with_other_words_in_each_episode_says_them_itself(known):
    with one_line_error(AdapterError, "expected 'push left' as declared, its class says 'push left, 0 times'; declare"):
        toy("OtherWords").open("push-left", VIEW_64)
    simulator = known(toy("OtherWords", own_words=True))
    with closing(simulator.open("push-right", VIEW_64)) as simulation:
        simulation.reset(4)
        assert simulation.observe().instruction == "push right, 4 times"
        row = rollout(simulation, load("untrained", {}), episode("untrained", condition=Condition("noise", 2)))
        assert row.status in ("success", "failure")


@pytest.mark.parametrize(
    ("name", "changes", "kind", "says"),
    [
        ("Pushs", {}, SimulatorUnavailable, "no such class in that module.*did you mean 'Pushes'"),
        ("not_a_class", {}, SimulatorUnavailable, "expected a StepBenchmark of vla-eval, got function"),
        ("NeedsItsSimulator", {}, SimulatorUnavailable, "cannot import .*no_such_simulator.*install it there"),
        ("Pushes", {"arguments": {"colour": 1}}, SimulatorUnavailable, "does not take these arguments: .*colour"),
        (
            "Pushes",
            {"action": {"move": Part(3), "gripper": Part(1)}},
            SimulatorUnavailable,
            "expected an action of move of 3, gripper of 1, as declared, the class has move of 2, gripper of 1",
        ),
        ("Pushes", {"tasks": {"push up": "go"}}, TaskUnavailable, "expected one task 'push up', it has none"),
        (
            "Pushes",
            {"arguments": {"words": False}, "tasks": {"push left": ""}},
            TaskUnavailable,
            "task 'push left': expected a sentence as task_description, got none; declare it in tasks",
        ),
        ("Pushes", {"cameras": {"third_person": "side"}}, AdapterError, "expected an image 'side'.*, got front"),
        ("Grey", {}, AdapterError, r"expected an image of bytes, \(height, width, 3\), as 'front', got shape \(8, 8\)"),
        ("Pushes", {"state": {"places": 3}}, AdapterError, "expected 3 numbers as 'places', as state says, got 2"),
        ("Pushes", {"arguments": {"places": False}}, AdapterError, "expected 2 numbers as 'places', .* got 0"),
        ("NoSuccess", {}, AdapterError, "expected success in its result, got score"),
        ("Waits", {}, AdapterError, "expected a StepBenchmark, whose methods do not wait"),
    ],
)
def test_what_a_class_lacks_is_one_line(name, changes, kind, says):
    simulator = toy(name, **changes)
    with one_line_error(kind, says), closing(simulator.open(next(iter(simulator.tasks)), VIEW_64)) as simulation:
        simulation.observe()
        simulation.step(np.zeros(3))


def test_a_module_that_is_none_is_one_line():
    for path in ("no_such_module:Pushes", "tests.adapters.no_such_module:Pushes"):
        given = {"tasks": SENTENCES, "action": ACTION, "cameras": {"third_person": "front"}}
        simulator = declare("toys", "Toys", path, horizon=9, control_hz=10.0, **given)
        with one_line_error(
            SimulatorUnavailable, f"^{re.escape(path)}: expected a module of this name in .*, found none"
        ):
            simulator.open("push-left", VIEW_64)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cameras": {}}, "cameras: expected third_person and perhaps wrist, got none"),
        ({"cameras": {"front": "front"}}, "cameras: expected third_person and perhaps wrist, got front"),
        ({"action": {}}, "action: expected a part or more, got none"),
        ({"action": {"raw": Part(0)}}, "action, state: expected 1 number or more in each part, got 0 in 'raw'"),
        ({"tasks": {"push it": "", "push-it": ""}}, "tasks: expected names that differ"),
    ],
)
def test_a_declaration_that_cannot_be_played_is_refused(changes, says):
    with pytest.raises(ValueError, match=f"^{says}"):
        toy(**changes)
    with pytest.raises(ValueError, match=r"^benchmark: expected MODULE:CLASS, got 'toys'"):
        declare("toys", "Toys", "toys", tasks=SENTENCES, action=ACTION, cameras={}, horizon=9, control_hz=1.0)


def test_a_policy_of_another_number_of_numbers_is_refused_in_one_line():
    with closing(toy().open("push-left", VIEW_64)) as simulation:
        for spec in (PolicySpec(PolicyInput.OBSERVATION, 8), PolicySpec(PolicyInput.OBSERVATION, 8, action_dim=4)):
            with one_line_error(PolicyMismatch, f"accepts 3 numbers per action, the policy produces {spec.action_dim}"):
                check_fit(spec, simulation.action_spec, simulation.observation_spec)


def test_what_is_written_of_a_class_declares_its_tasks():
    told, arguments = [], {"size": [48, 64]}
    module = listing("toys", f"{TOYS}:Pushes", arguments, 10.0, told.append)
    assert told == ["push left", "push right"]
    made = {}
    exec(module, made)  # as the package's import does
    assert replace(made["SIMULATOR"], open=None, title="") == replace(toy(arguments=arguments), open=None, title="")
    assert "own_words=True" in listing("toys", f"{TOYS}:OtherWords", {}, 10.0, told.append)
