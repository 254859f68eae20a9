"""Perturbation axes: what each changes, in which physical unit, and its five frozen severities. Standard library only.

Severities are physical quantities, never a simulator's own knob: halving every light leaves 73 % of the pixel value in
SAPIEN and 51 % in MuJoCo. They were set before any policy was evaluated and are not tuned to how policies do. A level
is drawn *at*, not up to: otherwise levels overlap and slopes flatten.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from suites.paraphrases import OTHER_GOALS, PARAPHRASES
from suites.vocabulary import CONTROLS, Condition

SEVERITIES = 5


class Changes(StrEnum):
    """What an axis changes. Everything else stays as it is in the clean episode, and that is checked."""

    CAMERAS = "cameras"
    """Where cameras are and how they look, in simulators that let them be moved."""
    IMAGES = "images"
    """What the cameras deliver; the same operator in every simulator."""
    ACTIONS = "actions"
    """What is executed of what the policy commands; the same operator in every simulator."""
    INSTRUCTION = "instruction"
    """The words in which the goal is given."""
    LIGHTS = "lights"
    """How the scene is lit."""
    STAGE = "stage"
    """How the table looks, and what stands on it to be seen and not touched."""
    OBJECTS = "objects"
    """Where the task's things are."""
    ARM = "arm"
    """Where the arm starts."""
    BODIES = "bodies"
    """How heavy and how slippery the task's things are."""
    NOTHING = "nothing"
    """Nothing at all."""

    @property
    def is_seen_only(self) -> bool:
        """Whether physics does not know of it: who acts without looking meets the clean world, step by step."""
        return self not in (Changes.ACTIONS, Changes.OBJECTS, Changes.ARM, Changes.BODIES)

    @property
    def starts_clean(self) -> bool:
        """Whether the episode starts from the physical state of the clean one."""
        return self not in (Changes.OBJECTS, Changes.ARM)


@dataclass(frozen=True, slots=True)
class Axis:
    """One perturbation axis."""

    name: str
    """As suites and reports name it."""
    code: str
    """Short, such as N1: the letter is the family."""
    title: str
    changes: Changes
    unit: str
    levels: tuple[float, ...]
    """The value at severity 1 (mild) to 5 (extreme but solvable); of a control one alone."""
    tolerance: float
    """How far what is delivered in an episode may be from what was asked for (same unit); infinite where a single
    episode is too short to tell."""
    summary: str
    anchors: str
    """What the levels are aligned with."""
    also: tuple[float, ...] = ()
    """A second quantity that goes with the levels, see the summary."""

    @property
    def is_control(self) -> bool:
        """Whether it has no scale: a condition in which success says something against a policy."""
        return self.name in CONTROLS

    def value(self, severity: int) -> float:
        """The level of a severity from 1 to 5.

        Raises:
            ValueError: There is no such severity.
        """
        if not 1 <= severity <= len(self.levels):
            raise ValueError(f"expected a severity from 1 to {len(self.levels)} on axis '{self.name}', got {severity}")
        return self.levels[severity - 1]


_ALL = (
    Axis(
        "camera-orbit",
        "C1",
        "camera orbit",
        Changes.CAMERAS,
        "deg",
        (5.0, 10.0, 20.0, 40.0, 75.0),
        0.1,
        "The third-person camera goes round what it is aimed at, to either side, and upwards by a fifth of that.",
        "robosuite's randomisation has 5; LIBERO-Plus turns by 10 and orbits by up to 75 (2510.13626)",
        (1.0, 2.0, 4.0, 8.0, 15.0),
    ),
    Axis(
        "camera-distance",
        "C2a",
        "camera distance",
        Changes.CAMERAS,
        "times",
        (1.05, 1.1, 1.25, 1.5, 2.0),
        0.005,
        "The third-person camera at so many times the distance from what it is aimed at.",
        "LIBERO-Plus reaches 2 (2510.13626)",
    ),
    Axis(
        "field-of-view",
        "C2b",
        "field of view",
        Changes.CAMERAS,
        "deg",
        (2.0, 5.0, 10.0, 15.0, 20.0),
        0.1,
        "The third-person camera's vertical field of view is wider by this.",
        "ManiSkill's randomisation has 2, robosuite's 5, RL-ViGen 10 and 20 (2307.10224)",
    ),
    Axis(
        "camera-bump",
        "C3",
        "bumped cameras",
        Changes.CAMERAS,
        "cm",
        (0.5, 1.0, 2.5, 5.0, 10.0),
        0.05,
        "Every camera is moved by this in a random direction, and turned by 0.5, 1, 2, 3, 5 deg about a random axis.",
        "ManiSkill's randomisation has 2.5 cm, Colosseum 10 cm and 2.9 deg (2402.08191)",
        (0.5, 1.0, 2.0, 3.0, 5.0),
    ),
    Axis(
        "illuminance",
        "L1",
        "dimmed light",
        Changes.LIGHTS,
        "EV darker",
        (0.5, 1.0, 1.5, 2.0, 3.0),
        0.15,
        "All lamps are dimmed by so many stops, measured in the linear light of the images. Darker only: brighter "
        "images saturate.",
        "1 EV is half the light; 3 EV take an office of 500 lux to a dim room of 60",
    ),
    Axis(
        "light-direction",
        "L2",
        "moved light",
        Changes.LIGHTS,
        "deg",
        (15.0, 30.0, 45.0, 60.0, 80.0),
        0.1,
        "The key light comes from a direction turned by this, to a random side, from 10 deg above the horizon at "
        "least. Shadows follow where the render profile draws any: `standard` does in PyBullet and robosuite.",
        "robosuite's randomisation has 20, Colosseum V2 draws any azimuth",
    ),
    Axis(
        "colour-temperature",
        "L3",
        "coloured light",
        Changes.LIGHTS,
        "K",
        (5500.0, 4500.0, 3500.0, 2700.0, 2000.0),
        300.0,
        "All lamps have the colour of a black body of this temperature instead of daylight's 6500 K, at the same "
        "luminance.",
        "from daylight to incandescent lamp and candle",
    ),
    Axis(
        "table",
        "T",
        "another table",
        Changes.STAGE,
        "dE*ab of the mean colour",
        (10.0, 20.0, 35.0, 50.0, 70.0),
        5.0,
        "The table is painted: its mean colour as the third-person camera sees it is this far from its own, in a "
        "random direction of CIELAB. Plain at 1 and 2, with a gradient at 3, chequered at 4, with blotches at 5.",
        "2 is just visible; Colosseum's random colours and textures are roughly 4 and 5 (2402.08191)",
    ),
    Axis(
        "distractors",
        "O2",
        "distractors",
        Changes.STAGE,
        "things",
        (1.0, 2.0, 4.0, 6.0, 10.0),
        0.0,
        "So many boxes, balls and cylinders of 3 to 5 cm stand on the table, half of them red, green or blue like the "
        "tasks' own things, at least 5 cm clear of these and of the straight way between them. They are drawn and "
        "cannot be touched, so nothing but seeing is tested.",
        "LIBERO-Plus adds 1 to 5 (2510.13626), RoboTwin 2.0 has 10 (2506.18088)",
    ),
    Axis(
        "object-position",
        "O1",
        "displaced object",
        Changes.OBJECTS,
        "cm outside",
        (1.0, 2.0, 4.0, 7.0, 10.0),
        0.1,
        "What the task is about lies this far outside the region from which resets draw its place, on a random side.",
        "LIBERO-Plus moves by 1 to 15 (2510.13626)",
    ),
    Axis(
        "robot-start",
        "R",
        "another start",
        Changes.ARM,
        "cm",
        (3.8, 7.6, 11.0, 15.0, 18.5),
        0.2,
        "The tool starts this far from its own start in a random direction, 3 cm above the table at least, and turned "
        "by 5, 10, 16, 21, 26 deg about a random axis where the arm can turn it (not in PyBullet).",
        "what LIBERO-Plus' offsets of 0.1 to 0.5 rad make of the tool's place in robosuite (2510.13626)",
        (5.0, 10.0, 16.0, 21.0, 26.0),
    ),
    Axis(
        "dynamics",
        "D",
        "mass and friction",
        Changes.BODIES,
        "times the mass",
        (1.25, 1.5, 2.0, 3.0, 5.0),
        0.01,
        "The task's things are so many times as heavy, and their friction is multiplied or divided, at random, by 1.1, "
        "1.25, 1.5, 2, 3.",
        "robosuite's randomisation has 10 % of friction, Colosseum more by task (2402.08191)",
        (1.1, 1.25, 1.5, 2.0, 3.0),
    ),
    Axis(
        "noise",
        "N1",
        "sensor noise",
        Changes.IMAGES,
        "dB PSNR",
        (34.0, 28.0, 22.0, 18.4, 14.9),
        0.2,
        "Gaussian noise, fresh in every frame and camera. Its deviation is set for each episode and camera so that the "
        "first image has this peak signal-to-noise ratio, whatever part of it is saturated.",
        "deviations .02 .04 .08 .12 .18 where nothing saturates; 3 to 5 are ImageNet-C's first three (1903.12261)",
    ),
    Axis(
        "blur",
        "N2",
        "blur",
        Changes.IMAGES,
        "% of image width",
        (0.3, 0.6, 1.0, 1.8, 2.7),
        0.0,
        "Gaussian blur of this deviation in every frame and camera.",
        "ImageNet-C spans 0.45 to 2.7 % at 224 px (1903.12261)",
    ),
    Axis(
        "frozen-frames",
        "N3",
        "frozen frames",
        Changes.IMAGES,
        "% of looks",
        (2.0, 5.0, 10.0, 20.0, 40.0),
        float("inf"),
        "At this share of the policy's looks, evenly spread from a random start, all cameras deliver the images of the "
        "look before. Proprioception stays fresh.",
        "a deployment fault; absent from LIBERO-Plus (2510.13626)",
    ),
    Axis(
        "action-noise",
        "A1",
        "action noise",
        Changes.ACTIONS,
        "cm per square-root second",
        (0.5, 1.0, 2.0, 4.0, 8.0),
        float("inf"),
        "Gaussian noise on each axis of the executed translation: after a second its sum has this deviation, whatever "
        "the control rate.",
        "demonstrations have 0.1 of the largest motion per step as noise, about severity 2 to 3",
    ),
    Axis(
        "action-delay",
        "A2",
        "action delay",
        Changes.ACTIONS,
        "ms",
        (50.0, 100.0, 200.0, 300.0, 400.0),
        25.0,
        "Every action is executed this much later, to the nearest control step; until the first arrives the robot is "
        "told to stay and to keep its fingers open.",
        "latencies of large policies served over a network",
    ),
    Axis(
        "instruction",
        "G",
        "other words",
        Changes.INSTRUCTION,
        "kind of rewording",
        (1.0, 2.0, 3.0, 4.0, 5.0),
        0.0,
        "The same goal in other words: 1 with a filler, 2 with synonyms, 3 with another syntax, 4 with things named by "
        "what they are or where they lie, 5 behind an irrelevant clause.",
        "kinds as in LIBERO-Plus (2510.13626) and VLABench's fourth track (2412.18194)",
    ),
)
_CONTROLS = (
    Axis(
        "blind",
        "V1",
        "black images",
        Changes.IMAGES,
        "control",
        (1.0,),
        0.0,
        "All images are black. What a policy still does it does without seeing.",
        "success here is no skill of seeing; it is the floor of every axis of images",
    ),
    Axis(
        "blank-instruction",
        "V2",
        "no instruction",
        Changes.INSTRUCTION,
        "control",
        (1.0,),
        0.0,
        "The instruction is empty. What a policy still does it does without being told.",
        "LIBERO-Plus finds that it changes little (2510.13626)",
    ),
    Axis(
        "wrong-goal",
        "V3",
        "another goal",
        Changes.INSTRUCTION,
        "control",
        (1.0,),
        0.0,
        "The instruction asks for something else that could be done in the same scene. A policy that reaches the "
        "task's own goal all the same does not listen.",
        "LIBERO-Plus finds that following collapses (2510.13626)",
    ),
    Axis(
        "again",
        "V4",
        "the same again",
        Changes.NOTHING,
        "control",
        (1.0,),
        0.0,
        "The clean episode once more. Anything but the same end, to the bit, says that numbers of this run are chance.",
        "users of LIBERO-Plus found runs to agree on 91 % of the episodes (its issue 61)",
    ),
)
AXES: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in (*_ALL, *_CONTROLS)})
"""Every axis by name, the controls last."""


def axis_of(condition: Condition) -> Axis | None:
    """The axis of a condition, or None for clean.

    Raises:
        ValueError: There is no such axis or severity.
    """
    if condition == Condition():
        return None
    if condition.axis not in AXES:
        raise ValueError(f"expected an axis out of {', '.join(AXES)}, got '{condition.axis}'")
    axis = AXES[condition.axis]
    axis.value(condition.severity)
    return axis


def why_unsupported(axis: Axis, instruction: str) -> str | None:
    """Why an axis cannot be brought about in a task, or None if it can.

    Args:
        axis: The axis.
        instruction: The task's own.
    """
    table = {"instruction": PARAPHRASES, "wrong-goal": OTHER_GOALS}.get(axis.name)
    if table is not None and instruction not in table:
        return f"there are no other words for '{instruction}' (suites/paraphrases.py)"
    return None
