"""What simulations let perturbations adjust in looks: lights, props, the table. Read back, seen, undone, not felt."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from adapters.adjusting import Form, Light, Prop, unit
from adapters.contract import FloatArray, Image
from orchestrator.conformance.adjusting import SEED, offered, play, restored
from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import Subject, changed
from suites.photometry import linear

DARK, BRIGHT = 60, 248
"""Between these values a pixel tells of the light."""
LEAST_LIT = 0.15
"""Share of the pixels that must."""
TALLEST = 0.1
"""Height of a small thing that stands on a table (m)."""


def _images(subject: Subject) -> dict[str, Image]:
    return dict(subject.simulation.observe().images)


def _stops(before: Image, after: Image) -> FloatArray:
    """Change of linear light (n,), in stops, of the pixels that tell of it.

    By their brightest channel: wood, for one, is too dark in blue to tell.
    """
    rows, columns = np.indices(before.shape[:2])
    brightest = before.argmax(axis=2)
    first, then = (image[rows, columns, brightest] for image in (before, after))
    lit = (first != then) & (first > DARK) & (first < BRIGHT)
    return np.asarray(np.log2(linear(then)[lit] / linear(first)[lit]))


@check(
    "lights-gain",
    look="`adjusters.lights`: gains are factors of linear light, see `adapters.adjusting.Light`",
    renders=True,
)
def lights_gain(subject: Subject) -> Iterator[Fault]:
    """A gain darkens linear light by as many stops, is read back, and changes nothing but images."""
    lights, faults = offered(subject, subject.adjusters.lights, "lights"), list[Fault]()
    with restored(subject, faults):
        own, before, state = lights.light(), _images(subject), subject.simulation.state_hash()
        if not np.allclose(own.gain, 1.0):
            yield Fault("a gain of 1 after a reset", str(own.gain))
        for stops in (-1.0, -3.0):
            lights.set_light(Light(np.full(3, 2.0**stops), own.direction))
            after = _images(subject)
            for camera in before:
                found = _stops(before[camera], after[camera])
                if len(found) < LEAST_LIT * before[camera][..., 0].size:
                    yield Fault(f"{camera} to be darker by {-stops:g} stops", "hardly any pixel changes")
                elif abs(np.median(found) - stops) > 0.15:
                    yield Fault(f"{camera} to be darker by {-stops:g} stops", f"{-np.median(found):.2f} stops")
            if not np.allclose(lights.light().gain, 2.0**stops, rtol=1e-3):
                yield Fault(f"a gain of {2.0**stops:g} to be read back", str(lights.light().gain))
        if subject.simulation.state_hash() != state:
            yield Fault("the same state in another light", "another")
    yield from faults


@check("lights-colour", look="`adjusters.lights.set_light`: a gain per channel", renders=True)
def lights_colour(subject: Subject) -> Iterator[Fault]:
    """A gain for each channel colours the light."""
    lights, faults = offered(subject, subject.adjusters.lights, "lights"), list[Fault]()
    camera = subject.view.cameras[0]
    with restored(subject, faults):
        before = _images(subject)[camera]
        lights.set_light(Light(np.array([1.0, 0.5, 0.25]), lights.light().direction))
        after = _images(subject)[camera]
        usable = (before[..., 2] != after[..., 2]) & ((before > DARK) & (before < BRIGHT)).all(axis=2)
        found = np.median(np.log2(linear(after)[usable] / linear(before)[usable]), axis=0)
        if not np.allclose(found, [0.0, -1.0, -2.0], atol=0.2):
            yield Fault("red, green, blue to change by 0, -1 and -2 stops", f"{np.round(found, 2).tolist()}")
    yield from faults


@check("lights-direction", look="`adjusters.lights`: the direction of the key light, base frame", renders=True)
def lights_direction(subject: Subject) -> Iterator[Fault]:
    """A direction of the light is read back and changes the shading; set back, it shows the same as before."""
    lights, faults = offered(subject, subject.adjusters.lights, "lights"), list[Fault]()
    with restored(subject, faults):
        own, before = lights.light(), _images(subject)
        if abs(np.linalg.norm(own.direction) - 1.0) > 1e-6 or own.direction[2] <= 0.0:
            yield Fault("a direction of length 1, from the scene up to the lamp", str(own.direction))
        other = unit(np.array([0.8, -0.5, 0.4]))
        lights.set_light(Light(own.gain, other))
        if not np.allclose(lights.light().direction, other, atol=1e-5):
            yield Fault(f"the direction {other.round(3)} to be read back", str(lights.light().direction.round(3)))
        after = _images(subject)
        if max(changed(before[camera], after[camera], by=4) for camera in before) < 0.05:
            yield Fault("another shading with light from elsewhere", "the same images")
        lights.set_light(own)
        again = _images(subject)
        if max(changed(before[camera], again[camera], by=2) for camera in before) > 0.0:
            yield Fault("the own images in the own light", "others")
    yield from faults


def _props(subject: Subject, height: float) -> list[Prop]:
    centre = subject.simulation.privileged_state()["tcp_position"]
    return [
        Prop(form, np.array([centre[0] + 0.02, centre[1] + 0.12 * (i - 1), height + 0.02]), 0.04, 0.3, (0.9, 0.1, 0.6))
        for i, form in enumerate(Form)
    ]


@check("stage-props", look="`adjusters.stage.show` and `shown`", renders=True)
def stage_props(subject: Subject) -> Iterator[Fault]:
    """Props are seen where they were put, cannot be touched, and replace those before."""
    stage, faults = offered(subject, subject.adjusters.stage, "stage"), list[Fault]()
    with restored(subject, faults):
        before, state = _images(subject), subject.simulation.state_hash()
        props = _props(subject, stage.table_height)
        stage.show(props)
        after = _images(subject)
        if max(changed(before[camera], after[camera]) for camera in before) < 0.005:
            yield Fault("three props to be seen", "hardly any pixel changes")
        if not np.allclose(stage.shown(), [prop.position for prop in props], atol=1e-5):
            yield Fault("props where they were put", f"{np.round(stage.shown(), 3).tolist()}")
        if subject.simulation.state_hash() != state:
            yield Fault("the same state with props", "another")
        stage.show(props[:1])
        if len(stage.shown()) != 1:
            yield Fault("one prop in place of three", str(len(stage.shown())))
        stage.show([])
        again = _images(subject)
        if max(changed(before[camera], again[camera], by=0) for camera in before) > 0.0:
            yield Fault("the own images once the props are gone", "others")
        stage.show(props)
        with_props = play(subject)
    if len(stage.shown()) != 0:
        yield Fault("no props after a reset", str(len(stage.shown())))
    if play(subject) != with_props:
        yield Fault("an arm that moves through props as if there were none", "another end of the same actions")
    yield from faults


@check("stage-paint", look="`adjusters.stage.paint_table`", renders=True)
def stage_paint(subject: Subject) -> Iterator[Fault]:
    """The table is painted in its light, with patterns that are seen as such."""
    stage, faults = offered(subject, subject.adjusters.stage, "stage"), list[Fault]()
    camera = subject.view.cameras[0]

    def painted(texture: Image) -> FloatArray:
        stage.paint_table(texture)
        return np.asarray(_images(subject)[camera], dtype=np.float64)

    with restored(subject, faults):
        before, state = _images(subject)[camera], subject.simulation.state_hash()
        white, black = (painted(np.full((8, 8, 3), grey, np.uint8)) for grey in (255, 0))
        table = (white - black).min(axis=2) > 40
        if table.mean() < 0.05:
            yield Fault("white paint to be seen beside black on 5 % of the image", f"{100 * table.mean():.1f} %")
            return
        if changed(before, black.astype(np.uint8)) < 0.05:
            yield Fault("black paint to be seen", "the own image")
        red, green, blue = painted(np.tile(np.array([200, 60, 20], np.uint8), (8, 8, 1)))[table].mean(axis=0)
        if not red > green > blue:
            yield Fault("orange paint to be orange", f"red {red:.0f}, green {green:.0f}, blue {blue:.0f}")
        squares = np.kron(np.indices((16, 16)).sum(axis=0) % 2, np.ones((4, 4))) * 255
        chequered = painted(np.repeat(squares.astype(np.uint8)[..., None], 3, axis=2))
        difference = (chequered - painted(np.full((8, 8, 3), 128, np.uint8))).mean(axis=2)
        if min((difference > 20).mean(), (difference < -20).mean()) < 0.02:
            yield Fault("a chequered table to have light and dark squares", "it has not")
        if subject.simulation.state_hash() != state:
            yield Fault("the same state with another paint", "another")
    yield from faults


@check("stage-height", look="`adjusters.stage.table_height` (base frame, m)")
def stage_height(subject: Subject) -> Iterator[Fault]:
    """The table is where things stand."""
    stage = offered(subject, subject.adjusters.stage, "stage")
    objects = offered(subject, subject.adjusters.objects, "objects")
    state = subject.reset(SEED).privileged_state()
    things = [name for name in objects.placeable() if name != "goal"]
    if not things:
        raise NotApplicable("no thing stands on the table in this task")
    heights = {name: float(state[f"{name}_position"][2]) - stage.table_height for name in things}
    lowest = min(things, key=lambda name: heights[name])
    if heights[lowest] <= 0.0:
        yield Fault(f"the centre of {lowest} above the table", f"{heights[lowest]:+.3f} m")
    elif heights[lowest] > TALLEST / 2.0:
        raise NotApplicable(
            f"{lowest}, {heights[lowest]:.3f} m above table_height, is no small thing that stands there"
        )


CHECKS = (lights_gain, lights_colour, lights_direction, stage_props, stage_paint, stage_height)
