"""Each violation of the contract is reported by its check in one line."""

import os
from types import SimpleNamespace

import pytest

from robogauntlet.orchestrator.kit.adapter import CHECKS, actions, resources, seeds, types
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.orchestrator.kit.finding import Level
from tests.orchestrator.kit.adapter import (  # noqa: F401  register them
    camera_variants,
    joint_variants,
    object_variants,
    two_arm_variants,
)
from tests.orchestrator.kit.adapter.variants import VARIANTS

VIOLATIONS = [
    ("wrongshape", "observation", "the image of third_person as (96, 96, 3), uint8; seen: (96, 96, 4), uint8"),
    ("wrongtype", "observation", "the image of third_person as (96, 96, 3), uint8; seen: (96, 96, 3), float32"),
    ("singleprecision", "privileged-state", "tcp_position as (3,), float64; seen: (3,), float32"),
    ("centimetres", "units", "tcp_position within 2 m of the base; seen: [45."),
    ("centimetres", "proprioception", "position, tcp_position"),
    ("degrees", "units", "near (pi, 0, 0) rad, pointing down; seen: [180."),
    ("worldframe", "units", "tcp_position in front of the base: x forward, y left; seen: [-0.1"),
    ("scalarfirst", "proprioception", "axis-angle, axis_angle(tcp_quaternion)"),
    ("numpybool", "step-outcome", "a bool as success; seen: "),
    ("constanthash", "state-hash", "another hash after the tool has moved"),
    ("otherwords", "observation", "the task's instruction, 'touch the red ball'; seen: 'do something'"),
    ("blackimages", "images", "third_person to show something"),
    ("raisesatopen", "opens", "the task to open; seen: no licence for the engine: run `licence --renew`"),
    ("raisesinobserve", "observation", "seen: KeyError: 'agentview'; look at "),
    ("unseeded", "seeds", "seed 0 to start alike after other episodes"),
    ("sameforall", "seeds", "other seeds to start differently; seen: 1 of 4"),
    ("keepsfingers", "seeds", "to start alike after other episodes"),
    ("driftsunseen", "seeds", "which differ in the last bits only"),
    ("flickers", "seeds-images", "again; seen: others; look at parts of the image"),
    ("oneworld", "two-at-once", "the same end beside another simulation"),
    ("observingsteps", "observing", "the same state before and after an observation"),
    ("stale", "present", "third_person to show that the tool has moved by 10 steps; seen: the same image"),
    ("onebuffer", "own-images", "the first image of third_person to stay as it was"),
    ("drawsinstep", "step-draws-nothing", "ms in draw, which renders the observations"),
    ("actsincentimetres", "action-dx", "+0.000 m in z (a controller in centimetres?); look at Simulation.step"),
    ("actsindegrees", "action-rx", "to turn the tool by +0.150 rad; seen: it turned by +0.003 rad about x, +0.000 rad"),
    ("flippedy", "action-dy", "to move the tool by +0.050 m; seen: it moved by +0.000 m in x, -0.050 m in y"),
    ("toolframe", "action-dz", "-0.050 m in z"),
    ("turnsintoolframe", "action-rz", "-0.150 rad about z"),
    ("opensatplusone", "action-gripper", "fingers more than 0.04 m apart at -1"),
    ("ignoresinsecret", "action-rx", "it turned by +0.000 rad about x"),
    ("ignoresinsecret", "action-ignored", "an effect of rx, or its name in `ignored`"),
    ("actsthoughignored", "action-ignored", "no effect of gripper, which is declared ignored"),
    ("actsthoughignored", "action-gripper", "fingers that stay, since `gripper` is declared ignored"),
    ("unclipped", "action-clipped", "3 times the bounds to do what the bounds do"),
    ("clipsinplace", "action-unchanged", "the action as it was given"),
    ("alwayssuccess", "start-is-no-success", "no success at the first step of seed 0"),
    ("neversuccess", "oracle", "success of the oracle within 60 steps from seed 0; seen: failure after 60 steps"),
    ("playson", "ends", "`terminated` at step 5 of [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], as the environment says"),
    ("endsathorizon", "survives", "steps beyond the horizon of 60; seen: ValueError: executing action in terminated"),
    ("mirrored", "camera-viewpoint", "they move as in an image that is mirrored"),
    (
        "upsidedownwithoutcontrols",
        "camera-upright",
        "motion to go up in the third-person image as the tool goes up; seen: it goes down",
    ),
    ("upsidedown", "camera-viewpoint", "third_person, turned by 8 deg, to show the same things moved accordingly"),
    ("hangsfromtheceiling", "camera-upright", "the image's down to point down in the base frame; seen: it points to"),
    ("wristturnedround", "camera-viewpoint", "wrist, turned by 8 deg, to show the same things moved accordingly"),
    ("pictureupsidedown", "camera-picture", "the picture to look like the third-person image"),
    ("cameraelsewhere", "camera-place", "where tcp_position projects; seen: motion around row"),
    ("halfthelens", "camera-viewpoint", "third_person, turned by 8 deg"),
    ("camerastays", "camera-adjusted", "third_person to have the position that was set"),
    ("camerastays", "axis-camera-orbit", "5 deg; seen: "),
    (
        "camerakeepsitsplace",
        "camera-adjusted",
        "all as before after a reset, once third_person was moved; seen: other images",
    ),
    ("camerakeepsitsplace", "axis-camera-bump", "the clean episode after camera-bump@1; seen: other images"),
    ("cullsbythecentre", "culling", "wrist with culling to be that without, at the start; seen: "),
    ("cullsforitsownlens", "culling", "with moved cameras; seen: "),
    ("offersnothing", "adjusts", "cameras; seen: nothing offered by the simulation"),
    ("toosmallabox", "objects-box", "ball between (0.400, -0.120) m and (0.550, 0.120) m; seen: from (0.4"),
    (
        "toolargeabox",
        "objects-box",
        "ball to be put anywhere in a box of (0.500, 0.240) m; seen: 12 seeds spread over (0.1",
    ),
    ("tableontheleft", "table-height", "ball between the table's edges; seen: ["),
    ("tableabove", "table-height", "the centre of ball above the table; seen: -0."),
    ("slidesundeclared", "objects-box", "ball between (0.400, -0.120) m and (0.600, 0.120) m; seen: from (0.4"),
    ("rollsaway", "objects-move", "ball to stay at rest there; seen: it drifts by [0.006"),
    ("goalmisspelt", "goal", "to: an entry of the privileged state, ball_position, finger_positions, tcp_position"),
    ("goalofanangle", "goal", "axes: 'xyz', since 'finger_positions' is no position; seen: 'xy'"),
    ("goalreached", "goal", "the goal farther than its tolerance of 2 at the start of one of 4 seeds; seen: at most"),
    ("motionelsewhere", "motion", "tool: [0."),
    ("motionoffewer", "motion", "a Motion with 3 entries; seen: Motion("),
    ("motionsteps", "motion", "the same state before and after reading a motion"),
    ("motionpulls", "motion", "a contact force of 0 N or more, or None; seen: -1.0"),
    ("secondgoesback", "action-dx", "in second_dx to move the tool by +0.050 m"),
    ("secondnevergrips", "action-gripper", "at -1 of second_gripper"),
    ("secondnevergrips", "action-ignored", "an effect of second_gripper, or its name in `ignored`"),
    ("saysithasonearm", "specs", "1 as `arms`, as the TaskDescription says; seen: 2"),
    ("hidesthesecondarm", "privileged-state", "`second_tcp_position`"),
    ("hidesthesecondbase", "privileged-state", "`second_base_position`"),
    ("jointsindegrees", "action-joints", "first to turn by +0.10 rad when its target does"),
    ("jointsswapped", "action-joints", "first to turn by +0.10 rad when its target does, and no other joint; seen: "),
    ("jacobianofanotherarm", "action-joints", "with first, as tcp_jacobian says"),
    ("jointsunlimited", "action-clipped", "3 times the bounds to do what the bounds do"),
    ("slowjoints", "action-joints", "the target of first to change by 0.3 rad, its `step` or what its range leaves"),
    ("ofatool", "observation", "`of_joints` True, as the ActionSpec says; seen: False"),
    ("otherjoints", "specs", "joints shoulder, elbow, wrist, as the TaskDescription says; seen: first, second, third"),
    ("velocitiesperstep", "action-joints", "first to turn by +0.10 rad when its target does"),
    ("saystargets", "specs", "targets of joints, as the TaskDescription says; seen: velocities of joints"),
    ("hidesthetargets", "privileged-state", "`joint_targets`"),
    ("followsbeyond", "action-clipped", "3 times the bounds to do what the bounds do"),
    ("othernumbers", "specs", "numbers x, y, z, as the TaskDescription says; seen: east, north, height"),
    ("hideswhatisstill", "privileged-state", "still as an array; seen: NoneType"),
    ("ofarobot", "observation", "`native` 3, as the ActionSpec says; seen: None"),
    ("readselsewhere", "proprioception", "state: ["),
    ("keepsmemory", "memory", "memory to grow by less than 16 MB in 400 resets"),
    ("keepsfiles", "closes", "2 more file descriptor(s)"),
    ("keepsthreads", "closes", "2 more Python thread(s)"),
    ("closesonce", "closes", "AdapterError: already closed"),
]


@pytest.mark.parametrize(
    ("variant", "check", "line"), VIOLATIONS, ids=[f"{variant}-{check}" for variant, check, _ in VIOLATIONS]
)
def test_each_broken_promise_is_reported_in_a_line_by_its_check(subject, variant, check, line):
    results = CHECKS[check].run(subject(variant))
    assert {result.level for result in results} == {Level.FAILED}
    text = str(results[0])
    assert text.startswith(f"{check}: expected ")
    assert line in text
    assert "\n" not in text


@pytest.mark.parametrize("check", sorted({check for _, check, _ in VIOLATIONS}))
def test_a_correct_adapter_passes_every_check_that_finds_a_violation(subject, check):
    special = {
        "objects-box": "movestheball",
        "objects-move": "movestheball",
        "table-height": "onatable",
        "culling": "culls",
        "motion": "moves",
        "action-joints": "jointsarecorrect",
        "ends": "endswithit",
    }
    correct = special.get(check, "correct")
    assert {result.level for result in CHECKS[check].run(subject(correct))} == {Level.OK}


@pytest.mark.parametrize("check", sorted({c.name for c in (*types.CHECKS, *actions.CHECKS)} - {"oracle"}))
def test_a_correct_adapter_of_two_arms_fails_no_check_of_its_numbers(subject, check):
    assert Level.FAILED not in {result.level for result in CHECKS[check].run(subject("botharecorrect"))}


@pytest.mark.parametrize("check", sorted({c.name for c in (*types.CHECKS, *actions.CHECKS)} - {"oracle"}))
@pytest.mark.parametrize("variant", ["jointsarecorrect", "planar", "velocities"])
def test_a_correct_adapter_of_joints_fails_no_check_of_its_numbers(subject, check, variant):
    assert Level.FAILED not in {result.level for result in CHECKS[check].run(subject(variant))}


@pytest.mark.parametrize("variant", ["nativeiscorrect", "unbounded"])
def test_a_correct_adapter_of_native_numbers_fails_no_check_and_those_of_robots_say_why_they_are_skipped(
    subject, variant
):
    apart = {"seeds-new-process", "memory", "pace", "oracle"}
    found = {name: check.run(subject(variant))[0] for name, check in CHECKS.items() if name not in apart}
    assert [str(finding) for finding in found.values() if finding.level is Level.FAILED] == []
    skipped = {name for name, one in found.items() if one.text == "an action has numbers of the environment's own"}
    assert skipped == {
        *(f"action-{name}" for name in ("dx", "dy", "dz", "rx", "ry", "rz", "joints", "gripper")),
        *("units", "camera-upright"),
    }
    assert {found[name].level for name in ("seeds", "present", "state-hash", "action-ignored")} == {Level.OK}


@pytest.mark.parametrize("check", ["state-hash", "present"])
@pytest.mark.parametrize("variant", ["planar", "onlymovesalongx"])
def test_the_tool_is_moved_as_the_arm_can(subject, check, variant):
    assert {result.level for result in CHECKS[check].run(subject(variant))} == {Level.OK}


def test_no_check_steps_a_simulation_past_its_end(subject):
    for check in (check for check in CHECKS.values() if not check.name.startswith(("axis-", "memory", "seeds-new"))):
        results = check.run(subject("endsearly"))
        assert not [str(result) for result in results if "stepped past" in str(result)]


def test_culling_is_not_checked_where_all_shapes_are_drawn(subject):
    (result,) = CHECKS["culling"].run(subject("correct"))
    assert (result.level, result.text) == (Level.SKIPPED, "the simulation has no `culling`, so it draws all shapes")


@pytest.mark.parametrize(("variant", "check"), [("nogoal", "goal"), ("correct", "motion")])
def test_what_an_adapter_may_leave_out_is_not_checked(subject, variant, check):
    assert CHECKS[check].run(subject(variant))[0].level is Level.SKIPPED


def test_a_start_may_be_outside_the_box_by_the_settling_shift(subject):
    assert CHECKS["objects-box"].run(subject("slidesasdeclared"))[0].level is Level.OK


def test_an_object_is_moved_away_from_all_others(subject):
    assert CHECKS["objects-move"].run(subject("hasaneighbour"))[0].level is Level.OK


def test_a_declaration_that_imports_its_simulator_is_reported():
    subject = CheckedTask(VARIANTS["correct"], "Reach", loaded_by_declaring=frozenset({"mujoco", "json"}))
    (result,) = CHECKS["declaration"].run(subject)
    assert "seen: it imports mujoco;" in str(result)


def test_file_and_line_of_an_adapters_exception_are_reported(subject):
    (result,) = CHECKS["observation"].run(subject("raisesinobserve"))
    file, _, rest = result.look.partition(":")
    assert file.endswith("variants.py")
    assert rest.endswith("in observe")


def test_a_step_that_is_too_slow_for_a_run_is_reported(subject, monkeypatch):
    monkeypatch.setitem(resources.LIMITS_S, "step", 0.02)
    assert "step to take less than 0.02 s; seen: 0.03" in str(CHECKS["pace"].run(subject("slow"))[0])
    assert CHECKS["pace"].run(subject("correct"))[0].level is Level.OK


def test_free_memory_of_the_process_does_not_hide_growth(subject):
    several = [os.urandom(1 << 10) * 100 for _ in range(1000)]
    last = several.pop()  # keeps what is below it in the heap from going back to the system
    del several
    (result,) = CHECKS["memory"].run(subject("keepsmemory"))
    del last
    assert result.level is Level.FAILED


def test_a_task_that_does_not_open_fails_once_and_skips_the_rest(subject):
    closed = subject("raisesatopen")
    outcomes = {name: check.run(closed)[0].level for name, check in CHECKS.items()}
    assert [name for name, outcome in outcomes.items() if outcome is Level.FAILED] == ["opens"]
    assert [name for name, outcome in outcomes.items() if outcome is Level.OK] == ["declaration", "description"]


@pytest.mark.parametrize(
    ("states", "seen"),
    [
        (None, ["other seeds to start differently; seen: 2 of 4"]),
        (3, ["other seeds to start differently; seen: 2 of 3"]),
        *((states, []) for states in (1, 2)),
        (-1, ["start_states to be None, or 1 or more; seen: -1"]),
    ],
)
def test_a_task_that_stores_states_starts_from_as_many_as_it_says(monkeypatch, states, seen):
    monkeypatch.setattr(seeds, "trace", lambda subject, seed: seeds.Trace(f"{seed % 2}", "", ""))
    task = SimpleNamespace(description=SimpleNamespace(start_states=states))
    assert [f"{one.expected}; seen: {one.seen}" for one in CHECKS["seeds"].body(task)] == seen
