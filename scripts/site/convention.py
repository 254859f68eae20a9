"""Draws docs/images/concepts/convention.svg from frames of PyBullet: `python -m scripts.site.convention`."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Image as Pixels, Observation, Simulation
from robogauntlet.adapters.scene_control import Viewpoint, scene_controls_of
from robogauntlet.suites.episode import View
from scripts.site.drawing import DOCS, Drawing

FILE = DOCS / "images" / "concepts" / "convention.svg"
TASK, SEED = "pybullet/PandaPickAndPlace-v3", 0
RENDERED, LARGE, SMALL, FINGERS = 840, 420, 200, 96
"""Sizes of the rendered frames, and of the third-person, wrist and gripper images in the drawing (px)."""
LENGTH = 0.14
"""Of the arrows (m)."""
AXES = (("x forward", "one", (1, 0, 0)), ("y left", "two", (0, 1, 0)), ("z up", "three", (0, 0, 1)))
GRIPPER_STEPS = 15


class Frame:
    """An image in the drawing, with the camera that took it."""

    def __init__(self, sheet: Drawing, x: float, y: float, size: float, viewpoint: Viewpoint) -> None:
        self._sheet, self._x, self._y, self._size, self._viewpoint = sheet, x, y, size, viewpoint

    def place(self, point: np.ndarray) -> tuple[float, float]:
        """Return where a point (3,) of the base frame (m) is in the drawing."""
        right, down, forward = self._viewpoint.rotation.T @ (point - self._viewpoint.position)
        focal = self._size / 2 / math.tan(self._viewpoint.fovy / 2)
        return (
            self._x + self._size / 2 + focal * right / forward,
            self._y + self._size / 2 + focal * down / forward,
        )

    def axes(self, origin: np.ndarray, length: float) -> None:
        """Draw the axes of the base frame at a point (3,)."""
        for name, kind, direction in AXES:
            start, end = self.place(origin), self.place(origin + length * np.array(direction))
            if math.dist(start, end) < 12:  # it points at the camera
                continue
            self._sheet.arrow([start, end], f"line-{kind}", head=f"fill-{kind}")
            away = 1 if end[0] >= start[0] else -1
            self._sheet.label(end[0] + 6 * away, end[1] + 4, name, kind, anchor="start" if away > 0 else "end")


def frames(simulation: Simulation) -> tuple[Observation, Pixels, Pixels]:
    """Return the first observation, and third-person images of the open and the closed gripper."""
    images = []
    for command in (-1.0, 1.0):
        simulation.reset(SEED)
        for _ in range(GRIPPER_STEPS):
            simulation.step(np.array([0.0] * 6 + [command]))
        images.append(simulation.observe().images["third_person"])
    simulation.reset(SEED)
    return simulation.observe(), images[0], images[1]


def draw() -> str:
    """Return the drawing as an SVG file."""
    simulation = catalog.open_simulation(TASK, View(image_size=RENDERED))
    try:
        seen, opened, closed = frames(simulation)
        state = simulation.privileged_state()
        cameras = scene_controls_of(simulation).cameras
        assert cameras is not None
        outside, on_hand = cameras.viewpoint("third_person"), cameras.viewpoint("wrist")
    finally:
        simulation.close()
    tool, turn = state["tcp_position"], Rotation.from_quat(state["tcp_quaternion"])
    wrist = Viewpoint(tool + turn.apply(on_hand.position), turn.as_matrix() @ on_hand.rotation, on_hand.fovy)
    sheet = Drawing(760, 470)
    top, column = 28, LARGE + 24
    sheet.text(0, 16, "third_person", "bold")
    sheet.image(0, top, LARGE, jpeg(seen.images["third_person"], LARGE))
    third = Frame(sheet, 0, top, LARGE, outside)
    third.axes(tool, LENGTH)
    sheet.text(column, 16, "wrist", "bold")
    sheet.image(column, top, SMALL, jpeg(seen.images["wrist"], SMALL))
    Frame(sheet, column, top, SMALL, wrist).axes(tool, LENGTH / 4)
    beside = column + SMALL + 12
    x, y = (
        round((value - offset) * RENDERED / LARGE) for value, offset in zip(third.place(tool), (0, top), strict=True)
    )
    for number, (name, image) in enumerate((("gripper -1, open", opened), ("gripper +1, closed", closed))):
        upper = top + number * (FINGERS + 8)
        sheet.image(beside, upper, FINGERS, jpeg(around(image, x, y), FINGERS))
        sheet.label(beside + FINGERS / 2, upper + FINGERS - 6, name, "ink", anchor="middle")
    _numbers(sheet, column, top + SMALL + 26, seen.proprioception)
    return sheet.svg()


def _numbers(sheet: Drawing, x: float, y: float, proprioception: np.ndarray) -> None:
    shown = [f"{value:.2f}".replace("-0.00", "0.00") for value in proprioception]
    rows: Sequence[tuple[str, str, str]] = (
        ("action: 7 numbers per control step", "", "bold"),
        ("dx dy dz", "translation of the tool, m", "small"),
        ("rx ry rz", "rotation about the same axes, rad", "small"),
        ("", "(axis-angle, right-handed)", "small"),
        ("gripper", "-1 open .. +1 closed", "small"),
        ("", "", ""),
        ("proprioception: 8 numbers, here", "", "bold"),
        ("position", f"{'  '.join(shown[:3])}  m", "small"),
        ("axis-angle", f"{'  '.join(shown[3:6])}  rad", "small"),
        ("fingers", f"{'  '.join(shown[6:])}  m", "small"),
        ("", "", ""),
        ("all in the frame of the robot's base", "", "soft small"),
    )
    for number, (name, content, kind) in enumerate(rows):
        for left, text in ((x, name), (x + 78, content)):
            if text:
                sheet.text(left, y + 17.5 * number, text, kind)


def around(image: Pixels, x: int, y: int) -> Pixels:
    """Cut out the gripper around a pixel, (2 FINGERS, 2 FINGERS, 3)."""
    left, upper = x - FINGERS, y - FINGERS - FINGERS // 3
    return image[max(0, upper) : upper + 2 * FINGERS, max(0, left) : left + 2 * FINGERS]


def jpeg(image: Pixels, size: int) -> str:
    """Return an image, reduced to a size (px) for twice as dense screens, as a data URL."""
    picture = Image.fromarray(image).resize((2 * size, 2 * size), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=82)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


if __name__ == "__main__":
    FILE.write_text(draw(), encoding="utf-8")
