"""Scene controls that act on images alone: lights, props, the table. Read back, seen, undone, without physics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.photometry import linear
from robogauntlet.adapters.scene_control import Form, Light, Lights, Prop, TableControl, unit
from robogauntlet.orchestrator.kit.adapter.check import NotApplicable, Violation, check, expect
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask, changed, most_changed
from robogauntlet.orchestrator.kit.adapter.scene_control import SEED, control_check, offered, play

DARK, BRIGHT = 60, 248
"""Pixel values between which a change of light can be measured."""
LEAST_LIT = 0.15
"""Smallest share of such pixels."""
TALLEST = 0.1
"""Height of a small object that stands on a table (m)."""


def _images(subject: CheckedTask) -> dict[str, Image]:
    return dict(subject.simulation.observe().images)


def _stops(before: Image, after: Image) -> FloatArray:
    """Change of linear light (n,), in stops, of the pixels that show it.

    Measured in their brightest channel, since wood, for example, is too dark in blue.
    """
    rows, columns = np.indices(before.shape[:2])
    brightest = before.argmax(axis=2)
    first, then = (image[rows, columns, brightest] for image in (before, after))
    lit = (first != then) & (first > DARK) & (first < BRIGHT)
    return np.asarray(np.log2(linear(then)[lit] / linear(first)[lit]))


def _expect_state(subject: CheckedTask, state: str, expected: str) -> Iterator[Violation]:
    yield from expect(subject.simulation.state_hash() == state, expected, "another")


@control_check(
    "lights-gain",
    "lights",
    look="`scene_controls.lights`: gains are factors of linear light, see `robogauntlet.adapters.scene_control.Light`",
    renders=True,
)
def lights_gain(subject: CheckedTask, lights: Lights) -> Iterator[Violation]:
    """A gain darkens linear light by as many stops, is read back, and changes nothing but images."""
    own, before, state = lights.light(), _images(subject), subject.simulation.state_hash()
    yield from expect(np.allclose(own.gain, 1.0), "a gain of 1 after a reset", own.gain)
    for stops in (-1.0, -3.0):
        lights.set_light(Light(np.full(3, 2.0**stops), own.direction))
        after = _images(subject)
        for camera in before:
            if (before[camera].max(axis=2) >= BRIGHT).mean() > 1.0 - LEAST_LIT and camera != subject.view.cameras[0]:
                continue  # It sees a white table and little else.
            change, expected = _stops(before[camera], after[camera]), f"{camera} to be darker by {-stops:g} stops"
            if len(change) < LEAST_LIT * before[camera][..., 0].size:
                yield Violation(expected, "hardly any pixel changes")
            elif abs(np.median(change) - stops) > 0.15:
                yield Violation(expected, f"{-np.median(change):.2f} stops")
        gain = lights.light().gain
        yield from expect(np.allclose(gain, 2.0**stops, rtol=1e-3), f"a gain of {2.0**stops:g} to be read back", gain)
    yield from _expect_state(subject, state, "the same state in another light")


@control_check("lights-colour", "lights", look="`scene_controls.lights.set_light`: a gain per channel", renders=True)
def lights_colour(subject: CheckedTask, lights: Lights) -> Iterator[Violation]:
    """A gain for each channel colours the light."""
    camera = subject.view.cameras[0]
    before = _images(subject)[camera]
    lights.set_light(Light(np.array([1.0, 0.5, 0.25]), lights.light().direction))
    after = _images(subject)[camera]
    usable = (before[..., 2] != after[..., 2]) & ((before > DARK) & (before < BRIGHT)).all(axis=2)
    change = np.median(np.log2(linear(after)[usable] / linear(before)[usable]), axis=0)
    expected = "red, green, blue to change by 0, -1 and -2 stops"
    yield from expect(np.allclose(change, [0.0, -1.0, -2.0], atol=0.2), expected, np.round(change, 2).tolist())


@control_check(
    "lights-direction",
    "lights",
    look="`scene_controls.lights`: the direction of the key light, base frame",
    renders=True,
)
def lights_direction(subject: CheckedTask, lights: Lights) -> Iterator[Violation]:
    """A direction of the light is read back and changes the shading; set back, it shows the same as before."""
    own, before = lights.light(), _images(subject)
    up = abs(np.linalg.norm(own.direction) - 1.0) <= 1e-6 and own.direction[2] > 0.0
    yield from expect(up, "a direction of length 1, from the scene up to the lamp", own.direction)
    other = unit(np.array([0.8, -0.5, 0.4]))
    lights.set_light(Light(own.gain, other))
    direction = lights.light().direction
    same = np.allclose(direction, other, atol=1e-5)
    yield from expect(same, f"the direction {other.round(3)} to be read back", direction.round(3))
    shaded = most_changed(before, _images(subject), by=4) >= 0.05
    yield from expect(shaded, "another shading with light from another direction", "the same images")
    lights.set_light(own)
    yield from expect(most_changed(before, _images(subject), by=2) == 0.0, "the own images in the own light", "others")


def three_props(subject: CheckedTask, height: float) -> list[Prop]:
    """Return a prop of each form beside the tool, on a table of this height (m)."""
    centre = subject.simulation.privileged_state()["tcp_position"]
    return [
        Prop(form, np.array([centre[0] + 0.02, centre[1] + 0.12 * (i - 1), height + 0.02]), 0.04, 0.3, (0.9, 0.1, 0.6))
        for i, form in enumerate(Form)
    ]


@control_check("table-props", "table", look="`scene_controls.table.show` and `shown`", renders=True)
def table_props(subject: CheckedTask, table: TableControl) -> Iterator[Violation]:
    """Props are seen where they were put, cannot be touched, and replace those before."""
    before, state = _images(subject), subject.simulation.state_hash()
    props = three_props(subject, table.table_height)
    table.show(props)
    visible = most_changed(before, _images(subject)) >= 0.005
    yield from expect(visible, "three props to be seen", "hardly any pixel changes")
    same = np.allclose(table.shown(), [prop.position for prop in props], atol=1e-5)
    yield from expect(same, "props where they were put", np.round(table.shown(), 3).tolist())
    yield from _expect_state(subject, state, "the same state with props")
    table.show(props[:1])
    yield from expect(len(table.shown()) == 1, "one prop in place of three", len(table.shown()))
    table.show([])
    same = most_changed(before, _images(subject), by=0) == 0.0
    yield from expect(same, "the own images once the props are gone", "others")
    table.show(props)
    with_props = play(subject)
    subject.reset(SEED)
    yield from expect(len(table.shown()) == 0, "no props after a reset", len(table.shown()))
    same = play(subject) == with_props
    yield from expect(same, "an arm that moves through props without contact", "another end of the same actions")


@control_check("table-paint", "table", look="`scene_controls.table.paint_table`", renders=True)
def table_paint(subject: CheckedTask, table: TableControl) -> Iterator[Violation]:
    """The table is painted, with its shading, and patterns are visible."""
    camera = subject.view.cameras[0]

    def painted(texture: Image) -> FloatArray:
        table.paint_table(texture)
        return np.asarray(_images(subject)[camera], dtype=np.float64)

    before, state = _images(subject)[camera], subject.simulation.state_hash()
    white, black = (painted(np.full((8, 8, 3), grey, np.uint8)) for grey in (255, 0))
    painted_area = (white - black).min(axis=2) > 40
    if painted_area.mean() < 0.05:
        yield Violation("white paint to differ from black on 5 % of the image", f"{100 * painted_area.mean():.1f} %")
        return
    visible = changed(before, black.astype(np.uint8)) >= 0.05
    yield from expect(visible, "black paint to be seen", "the own image")
    red, green, blue = painted(np.tile(np.array([200, 60, 20], np.uint8), (8, 8, 1)))[painted_area].mean(axis=0)
    colours = f"red {red:.0f}, green {green:.0f}, blue {blue:.0f}"
    yield from expect(red > green > blue, "orange paint to be orange", colours)
    squares = np.kron(np.indices((16, 16)).sum(axis=0) % 2, np.ones((4, 4))) * 255
    chequered = painted(np.repeat(squares.astype(np.uint8)[..., None], 3, axis=2))
    difference = (chequered - painted(np.full((8, 8, 3), 128, np.uint8))).mean(axis=2)
    visible = min((difference > 20).mean(), (difference < -20).mean()) >= 0.02
    yield from expect(visible, "a chequered table to have light and dark squares", "it has not")
    yield from _expect_state(subject, state, "the same state with another paint")


@check("table-height", look="`table_height` and `table_edges` of `scene_controls.table` (base frame, m)")
def table_height(subject: CheckedTask) -> Iterator[Violation]:
    """Objects stand on the table."""
    table, objects = offered(subject, "table"), offered(subject, "objects")
    state = subject.reset(SEED).privileged_state()
    names = [name for name in objects.placeable() if name != "goal"]
    if not names:
        raise NotApplicable("no object stands on the table in this task")
    heights = {name: float(state[f"{name}_position"][2]) - table.table_height for name in names}
    lowest = min(names, key=lambda name: heights[name])
    height = heights[lowest]
    yield from expect(height > 0.0, f"the centre of {lowest} above the table", f"{height:+.3f} m")
    if height > TALLEST / 2.0:
        raise NotApplicable(f"{lowest}, {height:.3f} m above table_height, is not a small object that stands there")
    low, high = np.asarray(table.table_edges, dtype=np.float64)
    for name in (name for name in names if heights[name] <= TALLEST / 2.0):
        place = state[f"{name}_position"][:2]
        inside = ((low < place) & (place < high)).all()
        found = f"{np.round(place, 3).tolist()}, edges {np.round([low, high], 3).tolist()}"
        yield from expect(inside, f"{name} between the table's edges", found)


CHECKS = (lights_gain, lights_colour, lights_direction, table_props, table_paint, table_height)
