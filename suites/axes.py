"""Perturbation axes with their physical units and five fixed severities, and controls. Standard library only.

Severities are physical quantities, not parameters of a simulator: halving every light leaves 73 % of the pixel value in
SAPIEN and 51 % in MuJoCo. They were set before any policy was evaluated and are not tuned to results. An episode is
perturbed by exactly the value of its severity, not by up to it: otherwise severities overlap and slopes flatten.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from robogauntlet.suites.axis import Axis, Changes
from robogauntlet.suites.episode import CONTROLS, Condition
from robogauntlet.suites.timing import TimingMode

SEVERITIES = 5
VARIANT_NAME = "variant-name"
NO_VARIANT_NAME = "the instruction that its benchmark's own code gives is no other"
"""Why a task does not support that control."""


_ALL = (
    Axis(
        name="camera-orbit",
        changes=Changes.CAMERAS,
        unit="deg",
        levels=(5.0, 10.0, 20.0, 40.0, 75.0),
        tolerance=0.1,
        summary="The third-person camera is turned around its target, to either side, and upwards by a fifth of this.",
        references="robosuite's randomisation has 5; LIBERO-Plus turns by 10 and orbits by up to 75 (2510.13626)",
        secondary_levels=(1.0, 2.0, 4.0, 8.0, 15.0),
    ),
    Axis(
        name="camera-distance",
        changes=Changes.CAMERAS,
        unit="times",
        levels=(1.05, 1.1, 1.25, 1.5, 2.0),
        tolerance=0.005,
        unchanged=1.0,
        summary="The third-person camera is moved to this multiple of its distance from its target.",
        references="LIBERO-Plus reaches 2 (2510.13626)",
    ),
    Axis(
        name="field-of-view",
        changes=Changes.CAMERAS,
        unit="deg",
        levels=(2.0, 5.0, 10.0, 15.0, 20.0),
        tolerance=0.1,
        summary="The vertical field of view of the third-person camera is widened by this.",
        incomparable="lenses differ, so that the same angle is another magnification",
        references="ManiSkill's randomisation has 2, robosuite's 5, RL-ViGen 10 and 20 (2307.10224)",
    ),
    Axis(
        name="camera-bump",
        changes=Changes.CAMERAS,
        unit="cm",
        levels=(0.5, 1.0, 2.5, 5.0, 10.0),
        tolerance=0.05,
        summary="Every camera is moved by this in a random direction and turned by 0.5, 1, 2, 3, 5 deg about a random "
        "axis.",
        references="ManiSkill's randomisation has 2.5 cm, Colosseum 10 cm and 2.9 deg (2402.08191)",
        secondary_levels=(0.5, 1.0, 2.0, 3.0, 5.0),
    ),
    Axis(
        name="illuminance",
        changes=Changes.LIGHTS,
        unit="EV darker",
        levels=(0.5, 1.0, 1.5, 2.0, 3.0),
        tolerance=0.15,
        summary="All lights are dimmed by this, measured in linear light in the images. Only darker, because brighter "
        "images saturate.",
        references="1 EV is half the light; 3 EV take an office of 500 lux to a dim room of 60",
    ),
    Axis(
        name="light-direction",
        changes=Changes.LIGHTS,
        unit="deg",
        levels=(15.0, 30.0, 45.0, 60.0, 80.0),
        tolerance=0.1,
        summary="The direction of the key light is turned by this to a random side, at least 10 deg above the "
        "horizon. Shadows follow if the render profile draws them: `standard` does in PyBullet and robosuite.",
        references="robosuite's randomisation has 20, Colosseum V2 draws any azimuth",
    ),
    Axis(
        name="colour-temperature",
        changes=Changes.LIGHTS,
        unit="K",
        levels=(5500.0, 4500.0, 3500.0, 2700.0, 2000.0),
        tolerance=300.0,
        unchanged=6500.0,
        summary="All lights have the colour of a black body of this temperature instead of 6500 K (daylight), at the "
        "same luminance.",
        references="from daylight to incandescent lamp and candle",
    ),
    Axis(
        name="table",
        changes=Changes.TABLE,
        unit="dE*ab of the mean colour",
        levels=(10.0, 20.0, 35.0, 50.0, 70.0),
        tolerance=5.0,
        summary="The table gets another texture, whose mean colour in the third-person image differs by this from the "
        "original, in a random direction of CIELAB: uniform at 1 and 2, gradient at 3, checkered at 4, blotches at 5.",
        incomparable="it fills another share of each image, and its pattern is weaker in a light or a dark colour",
        references="2 is just visible; Colosseum's random colours and textures are roughly 4 and 5 (2402.08191)",
    ),
    Axis(
        name="distractors",
        changes=Changes.TABLE,
        unit="objects",
        levels=(1.0, 2.0, 4.0, 6.0, 10.0),
        tolerance=0.0,
        unchanged=None,
        summary="Boxes, balls and cylinders of 3 to 5 cm stand on the table, half of them red, green or blue like the "
        "tasks' objects, at least 5 cm away from these and from the straight line between them. They are rendered but "
        "cannot be touched, so the axis tests perception alone.",
        references="LIBERO-Plus adds 1 to 5 (2510.13626), RoboTwin 2.0 has 10 (2506.18088)",
    ),
    Axis(
        name="object-position",
        changes=Changes.OBJECTS,
        unit="cm outside",
        levels=(1.0, 2.0, 4.0, 7.0, 10.0),
        tolerance=0.1,
        summary="The task's object lies this far outside the region of its usual start positions, on a random side.",
        incomparable="the regions of usual start positions are 1 to 20 cm wide",
        references="LIBERO-Plus moves by 1 to 15 (2510.13626)",
    ),
    Axis(
        name="robot-start",
        changes=Changes.ARM,
        unit="cm",
        levels=(3.8, 7.6, 11.0, 15.0, 18.5),
        tolerance=0.2,
        summary="The gripper starts this far from its usual position in a random direction, at least 3 cm above the "
        "table, and turned by 5, 10, 16, 21, 26 deg about a random axis.",
        incomparable="policies can turn the tool back, but not in PyBullet",
        references="the displacement that LIBERO-Plus' offsets of 0.1 to 0.5 rad cause in robosuite (2510.13626)",
        secondary_levels=(5.0, 10.0, 16.0, 21.0, 26.0),
    ),
    Axis(
        name="dynamics",
        changes=Changes.DYNAMICS,
        unit="times the mass",
        levels=(1.25, 1.5, 2.0, 3.0, 5.0),
        tolerance=0.01,
        unchanged=1.0,
        summary="The mass of the task's objects is multiplied by this; the friction of their contacts is multiplied or "
        "divided, at random, by 1.1, 1.25, 1.5, 2, 3.",
        references="robosuite's randomisation has 10 % of friction, Colosseum more by task (2402.08191)",
        secondary_levels=(1.1, 1.25, 1.5, 2.0, 3.0),
    ),
    Axis(
        name="noise",
        changes=Changes.IMAGES,
        unit="dB PSNR",
        levels=(34.0, 28.0, 22.0, 18.4, 14.9),
        tolerance=0.2,
        unchanged=float("inf"),
        summary="Independent Gaussian noise in every frame and camera. Its deviation is set for each episode and "
        "camera so that the first image has this peak signal-to-noise ratio, however much of it is saturated.",
        references="deviations .02 .04 .08 .12 .18 where nothing saturates; 3 to 5 are ImageNet-C's first three "
        "(1903.12261)",
    ),
    Axis(
        name="blur",
        changes=Changes.IMAGES,
        unit="% of image width",
        levels=(0.3, 0.6, 1.0, 1.8, 2.7),
        tolerance=0.1,
        summary="Gaussian blur of this deviation in every frame and camera.",
        references="ImageNet-C spans 0.45 to 2.7 % at 224 px (1903.12261)",
    ),
    Axis(
        name="frozen-frames",
        changes=Changes.IMAGES,
        unit="% of observations",
        levels=(2.0, 5.0, 10.0, 20.0, 40.0),
        tolerance=float("inf"),
        summary="In this share of the policy's observations, evenly spaced from a random start, all cameras deliver "
        "the images of the previous observation. Proprioception is current.",
        incomparable="it depends on the number of observations, and over few often freezes none",
        references="a deployment fault; absent from LIBERO-Plus (2510.13626)",
    ),
    Axis(
        name="action-noise",
        changes=Changes.ACTIONS,
        unit="cm per square-root second",
        levels=(0.5, 1.0, 2.0, 4.0, 8.0),
        tolerance=float("inf"),
        summary="Gaussian noise on each axis of the executed translation. Its sum over one second has this deviation "
        "at every control rate.",
        incomparable="what exceeds the largest motion of a control step is cut off",
        references="demonstrations have 0.1 of the largest motion per step as noise, about severity 2 to 3",
    ),
    Axis(
        name="action-delay",
        changes=Changes.ACTIONS,
        unit="ms",
        levels=(50.0, 100.0, 200.0, 300.0, 400.0),
        tolerance=25.0,
        summary="Every action is executed this much later: the nearest number of control steps (half a step rounded "
        "up). Until the first action arrives, the robot is commanded to stay in place with its gripper open.",
        incomparable="it is a number of control steps, which are 50 ms long, 40 in PyBullet, 67 by robosuite's joints",
        references="latencies of large policies served over a network",
    ),
    *(
        Axis(
            name=name,
            changes=Changes.ACTIONS,
            unit="ms",
            levels=(50.0, 100.0, 200.0, 400.0, 800.0),
            tolerance=25.0,
            summary="Every answer of the policy takes this much longer in simulated time: the nearest number of "
            f"control steps (half a step rounded up). {meanwhile}",
            incomparable="it is a number of control steps, which differ in length between simulators",
            references="30 to 800 ms for models of 0.1 to 7 billion parameters (2506.07339, 2406.09246)",
        )
        for name, meanwhile in (
            ("latency", "Meanwhile the robot holds, and then executes the answer from its beginning."),
            (
                "latency-continue",
                "Meanwhile the robot executes the rest of the last answer, and then the new one from the action that "
                "is due.",
            ),
            (
                "latency-blend",
                "As `latency-continue`, with the average of both answers where both have an action, of which the new "
                "one's share grows.",
            ),
        )
    ),
    Axis(
        name="instruction",
        changes=Changes.INSTRUCTION,
        unit="rewording type",
        levels=(1.0, 2.0, 3.0, 4.0, 5.0),
        tolerance=float("inf"),
        unchanged=None,
        ordered=False,
        summary="The instruction is paraphrased: 1 adds a filler, 2 uses synonyms, 3 changes the syntax, 4 refers to "
        "objects by kind or place, 5 adds an irrelevant clause.",
        incomparable="types of rewording are no scale",
        references="types as in LIBERO-Plus (2510.13626) and VLABench's fourth track (2412.18194)",
    ),
    Axis(
        name="blind",
        changes=Changes.IMAGES,
        unchanged=None,
        summary="All images are black. Success that remains does not depend on vision.",
        references="this success rate is the lower limit for every axis that changes images",
    ),
    Axis(
        name="blank-instruction",
        changes=Changes.INSTRUCTION,
        unchanged=None,
        summary="The instruction is empty. Success that remains does not depend on the instruction.",
        references="LIBERO-Plus reports that it changes little (2510.13626)",
    ),
    Axis(
        name="wrong-goal",
        changes=Changes.INSTRUCTION,
        unchanged=None,
        summary="The instruction asks for another goal of the same scene. A policy that reaches the task's ignores it.",
        references="LIBERO-Plus reports that instruction following collapses (2510.13626)",
    ),
    Axis(
        name=VARIANT_NAME,
        changes=Changes.INSTRUCTION,
        unchanged=None,
        summary="The instruction is the one that the benchmark's own code makes from a file's name: LIBERO-Plus's ends "
        "with the name of the variant, LIBERO-PRO's is that of the unchanged task.",
        references="LIBERO-Plus (2510.13626) in six of its seven axes, LIBERO-PRO (2510.03827) in all",
    ),
    Axis(
        name="resampled",
        changes=Changes.STARTS,
        unchanged=None,
        summary="The task's own rules place the objects, no stored state. Success that is lost depends on these.",
        references="LIBERO-PRO (2510.03827), and states within the range of training in 2606.04233",
    ),
    Axis(
        name="again",
        changes=Changes.NOTHING,
        unchanged=None,
        summary="The clean episode is repeated. One that is not bit-identical shows that the run is not deterministic.",
        references="users of LIBERO-Plus report that repeated runs agree on 91 % of the episodes (its issue 61)",
    ),
)
AXES: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in _ALL})
"""All axes by name, the controls last."""

LATENCY: Mapping[str, TimingMode] = MappingProxyType(
    {
        "latency": TimingMode.HOLD,
        "latency-continue": TimingMode.CONTINUE,
        "latency-blend": TimingMode.BLEND,
    }
)
"""Axes of answer times, with what the robot does meanwhile."""

_ONE_CAMERA = "both move the third-person camera, so neither value would be the delivered one"
_ONE_WAIT = "the robot waits for an answer in one way"
EXCLUSIVE = (
    ("camera-bump", "camera-orbit", _ONE_CAMERA),
    ("camera-bump", "camera-distance", _ONE_CAMERA),
    ("latency", "latency-continue", _ONE_WAIT),
    ("latency", "latency-blend", _ONE_WAIT),
    ("latency-continue", "latency-blend", _ONE_WAIT),
)
"""Pairs of axes that do not combine, with the reason. Controls combine with nothing."""


def axes_of(condition: Condition) -> dict[Axis, float]:
    """Return the axes of a condition with their severities; none for clean.

    Raises:
        ValueError: The condition names an unknown axis or severity, or axes that do not combine.
    """
    found = {}
    for part in condition.perturbations:
        if part.axis not in AXES:
            raise ValueError(f"expected one of the axes {', '.join(AXES)}; got '{part.axis}'")
        AXES[part.axis].value(part.severity)
        found[AXES[part.axis]] = part.severity
    if reason := why_exclusive([axis.name for axis in found]):
        raise ValueError(reason)
    return found


def why_exclusive(names: Iterable[str]) -> str | None:
    """Return the reason why these axes do not combine, or None if they do."""
    names = list(names)
    if len(names) < 2:
        return None
    for name in names:
        if name in CONTROLS:
            return f"the control '{name}' does not combine with others"
    for one, other, reason in EXCLUSIVE:
        if one in names and other in names:
            return f"'{one}' and '{other}' do not combine: {reason}"
    return None
