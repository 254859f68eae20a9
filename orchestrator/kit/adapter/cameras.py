"""Cameras: images are upright and not mirrored, and are rendered from the viewpoints that the adapter reports."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.camera_geometry import aim_point
from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.scene_control import Cameras, Viewpoint
from robogauntlet.orchestrator.kit.adapter.check import NotApplicable, Violation, check, expect, expect_restored
from robogauntlet.orchestrator.kit.adapter.checked_task import SIZE, CheckedTask, changed
from robogauntlet.orchestrator.perturbations.cameras import BASE_HEIGHT, THIRD_PERSON

ANGLE = math.radians(8.0)
"""Angle by which cameras are turned (rad)."""
LIKE = 0.5
"""Lowest correlation with the image that the turned camera should show."""
MOVED = 15
"""Difference of grey values above which a pixel shows motion."""
NEAREST, REACH = 0.3, 0.6
"""Least distance from the base at which a camera is aimed (m), and as a share of the tool's own if that is less."""
NEAR = 0.08
"""Largest distance of the motion from the fingers that close (share of the image)."""
RAISED = 0.05
"""Distance by which the tool is raised, twice (m)."""
SEED = 3
TURNS = ((1, 1.0), (1, -1.0), (0, 1.0), (0, -1.0))
"""Turns to the right, left, up and down: axis of the camera (right, down, forward) and sign."""
UPRIGHT = "upright"
ORIENTATIONS = {
    UPRIGHT: np.diag([1.0, 1.0, 1.0]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
    "upside down and mirrored": np.diag([1.0, -1.0, 1.0]),
    "turned by 180 degrees": np.diag([-1.0, -1.0, 1.0]),
}
"""Orientation of an image to its flips of right and down."""


def _cameras(subject: CheckedTask) -> Cameras:
    subject.reset()
    if subject.scene_controls.cameras is None:
        raise NotApplicable("the adapter has no camera poses (`scene_controls.cameras`) to compare with")
    return subject.scene_controls.cameras


def _grey(image: Image) -> FloatArray:
    return np.asarray(image, dtype=np.float64).mean(axis=2)


def _motion(before: Image, after: Image) -> NDArray[np.intp]:
    """Rows and columns (n, 2) of the pixels that differ between two images."""
    return np.argwhere(np.abs(_grey(before) - _grey(after)) > MOVED)


def _third_person_only(subject: CheckedTask) -> None:
    """Skip the check unless the third-person camera is rendered."""
    if THIRD_PERSON not in subject.view.cameras:
        raise NotApplicable("the third-person camera is not rendered")


@check(
    "camera-upright",
    look="the rows of the images: OpenGL's and Bullet's buffers begin at the bottom",
    renders=True,
    of_robots=True,
)
def upright(subject: CheckedTask) -> Iterator[Violation]:
    """The third-person image is upright."""
    _third_person_only(subject)
    simulation = subject.reset()
    if (cameras := subject.scene_controls.cameras) is not None:
        down = cameras.viewpoint(THIRD_PERSON).rotation[:, 1]
        seen = f"it points to {np.round(down, 2).tolist()}"
        yield from expect(down[2] < 0.0, "the image's down to point down in the base frame", seen)
        return  # whether images follow the viewpoint is the check camera-viewpoint
    images = [simulation.observe().images[THIRD_PERSON]]
    length = subject.length(0.01)
    for _ in range(2):
        for _ in range(math.ceil(RAISED / length)):
            simulation.step(subject.action(dz=length))
        images.append(simulation.observe().images[THIRD_PERSON])
    first, second = (_motion(before, after) for before, after in pairwise(images))
    if len(first) == 0 or len(second) == 0:
        raise NotApplicable("the third-person camera does not see the tool rise")
    risen = float(np.median(first[:, 0]) - np.median(second[:, 0]))
    yield from expect(
        risen >= 0.0,
        "motion to go up in the third-person image as the tool goes up",
        f"it goes down by {-risen:.1f} of {subject.view.image_size} px",
    )


@check("camera-viewpoint", look="`scene_controls.cameras.viewpoint`: right, down, forward and fovy", renders=True)
def viewpoint(subject: CheckedTask) -> Iterator[Violation]:
    """A camera that is turned, or has another lens, shows the image that a pinhole camera would show."""
    cameras = _cameras(subject)
    for camera in subject.view.cameras:
        own = cameras.viewpoint(camera)
        rotation = own.rotation
        yield from expect(
            np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-4) and np.linalg.det(rotation) >= 0.0,
            f"a right-handed rotation (right, down, forward) of {camera}",
            np.round(rotation, 2).tolist(),
        )
        image = subject.simulation.observe().images[camera]
        cameras.set_viewpoint(camera, own)
        share = changed(image, subject.simulation.observe().images[camera])
        same = f"{camera}, set to its own viewpoint, to show the same image"
        yield from expect(share <= 0.02, same, f"{share:.0%} other pixels")
        before = _smooth(image)
        correlations: dict[str, list[float]] = {name: [] for name in ORIENTATIONS}
        for axis, sign in TURNS:
            turn = Rotation.from_rotvec(sign * ANGLE * np.eye(3)[axis]).as_matrix()
            seen = _image_from(subject, cameras, camera, replace(own, rotation=rotation @ turn))
            for name, flip in ORIENTATIONS.items():
                homography = _homography(own.fovy, own.fovy, flip @ turn @ flip)
                correlations[name].append(_correlation(seen, before, homography))
        means = {name: float(np.mean(values)) for name, values in correlations.items()}
        best = max(means, key=lambda name: means[name])
        moved = f"{camera}, turned by {math.degrees(ANGLE):g} deg, to show the same things moved accordingly"
        if best != UPRIGHT:
            numbers = f"correlation {means[best]:.2f}, else {means[UPRIGHT]:.2f}"
            yield Violation(moved, f"they move as in an image that is {best} ({numbers})")
        elif means[best] < LIKE:
            yield Violation(moved, f"they do not (correlation {means[best]:.2f}, expected {LIKE:g})")
        wider = own.fovy + ANGLE
        seen = _image_from(subject, cameras, camera, replace(own, fovy=wider))
        found, same_lens = (
            _correlation(seen, before, _homography(own.fovy, to, np.eye(3))) for to in (wider, own.fovy)
        )
        yield from expect(
            found >= max(LIKE, same_lens),
            f"{camera} to show things smaller with a wider fovy (vertical, rad)",
            f"correlation {found:.2f} with that, {same_lens:.2f} with no change",
        )
        subject.reset()


def _image_from(subject: CheckedTask, cameras: Cameras, camera: str, viewpoint: Viewpoint) -> FloatArray:
    """The smooth image of a camera from a viewpoint."""
    cameras.set_viewpoint(camera, viewpoint)
    return _smooth(subject.simulation.observe().images[camera])


def _smooth(image: Image) -> FloatArray:
    """Grey values, blurred so that single pixels do not matter."""
    return np.asarray(gaussian_filter(_grey(image), SIZE / 64))


def _homography(fovy: float, to_fovy: float, turn: FloatArray) -> FloatArray:
    """Map pixel directions of the turned camera to those of the own camera: K R K'^-1 (Hartley and Zisserman, 8.4.2).

    Pixels are in units of half the image, from its centre, to the right and down.
    """
    own, other = (np.diag([1.0 / math.tan(f / 2.0)] * 2 + [1.0]) for f in (fovy, to_fovy))
    return own @ turn @ np.linalg.inv(other)


def _correlation(seen: FloatArray, before: FloatArray, homography: FloatArray) -> float:
    """Correlation of an image with an earlier one, moved by a homography, where they overlap."""
    size = len(seen)
    along = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    right, down = np.meshgrid(along, along)
    x, y, z = homography @ np.stack([right.ravel(), down.ravel(), np.ones(size * size)])
    columns, rows = ((part / z + 1.0) / 2.0 * size - 0.5 for part in (x, y))
    inside = (z > 0) & (columns >= 0) & (columns <= size - 1) & (rows >= 0) & (rows <= size - 1)
    moved = map_coordinates(before, [rows[inside], columns[inside]], order=1)
    return float(np.corrcoef(moved, seen.ravel()[inside])[0, 1])


@check("camera-place", look="`scene_controls.cameras.viewpoint` (base frame, m) and tcp_position", renders=True)
def place(subject: CheckedTask) -> Iterator[Violation]:
    """The fingers close in the third-person image where its viewpoint projects the tool."""
    cameras = _cameras(subject)
    _third_person_only(subject)
    if any(subject.ignores(f"{arm}gripper") for arm in subject.arms):
        raise NotApplicable("the gripper does nothing in this task, so it cannot be distinguished from the arm")
    for arm in subject.arms:
        simulation = subject.reset()
        # One jaw of a small arm may swing wide, and is near the tool at the end.
        opened = 0.5 if simulation.action_spec.joints else -1.0
        for _ in range(10):
            simulation.step(subject.action(**{f"{arm}gripper": opened}))
        before = simulation.picture()
        for _ in range(10):
            simulation.step(subject.action(**{f"{arm}gripper": 1.0}))
        motion = _motion(before, simulation.picture())
        if len(motion) == 0:
            raise NotApplicable("the third-person camera does not see the fingers close")
        tool = _tool(simulation.privileged_state(), arm)
        row, column = pixel(cameras.viewpoint(THIRD_PERSON), tool, len(before))
        seen_row, seen_column = np.median(motion, axis=0)
        where = f"row {row:.0f}, column {column:.0f} of the picture, where {arm}tcp_position projects"
        yield from expect(
            math.hypot(seen_row - row, seen_column - column) <= NEAR * len(before),
            f"the fingers to close near {where}",
            f"motion around row {seen_row:.0f}, column {seen_column:.0f}",
        )


def _tool(state: Mapping[str, FloatArray], arm: str) -> FloatArray:
    """The position (3,) of an arm's tool in the frame of the first arm's base (m)."""
    own = state[f"{arm}tcp_position"]
    if not arm:
        return own
    base = Rotation.from_quat(state[f"{arm}base_quaternion"])
    return np.asarray(base.apply(own) + state[f"{arm}base_position"])


def pixel(viewpoint: Viewpoint, point: FloatArray, size: int) -> tuple[float, float]:
    """Row and column at which a point (3,) in the viewpoint's frame appears in an image of `size` px."""
    right, down, forward = viewpoint.rotation.T @ (np.asarray(point) - viewpoint.position)
    scale = size / 2.0 / math.tan(viewpoint.fovy / 2.0) / forward
    return float(size / 2.0 + down * scale), float(size / 2.0 + right * scale)


@check("camera-aim", look="the pose of the third-person camera: perturbations orbit the point that it is aimed at")
def aim(subject: CheckedTask) -> Iterator[Violation]:
    """The third-person camera is aimed at the table in front of the robot."""
    _third_person_only(subject)
    own = _cameras(subject).viewpoint(THIRD_PERSON)
    x, y, _ = aim_point(own, BASE_HEIGHT)
    near = min(NEAREST, REACH * float(subject.reset().privileged_state()["tcp_position"][0]))
    expected = f"an optical axis that meets the base's height at x {near:.2g} to 0.9, y within 0.2 m"
    yield from expect(near < x < 0.9 and abs(y) < 0.2, expected, f"({x:.2f}, {y:.2f}) m")
    fovy = math.degrees(own.fovy)
    yield from expect(20.0 < fovy < 75.0, "a vertical field of view of 20 to 75 deg", f"{fovy:.0f} deg")


@check("camera-picture", look="Simulation.picture: the third-person view, at 256 px", renders=True)
def same_picture(subject: CheckedTask) -> Iterator[Violation]:
    """The picture for people shows the third-person view."""
    simulation = subject.reset()
    _third_person_only(subject)
    seen, shown = _smooth(simulation.observe().images[THIRD_PERSON]), _smooth(simulation.picture())
    along = (np.arange(len(seen)) + 0.5) / len(seen) * len(shown) - 0.5
    small = map_coordinates(shown, np.meshgrid(along, along, indexing="ij"), order=1)
    like = float(np.corrcoef(small.ravel(), seen.ravel())[0, 1])
    expected = "the picture to look like the third-person image, correlation 0.8 at least"
    yield from expect(like >= 0.8, expected, f"{like:.2f}")


@check("camera-adjusted", look="`scene_controls.cameras.set_viewpoint` and reset", renders=True)
def adjusted(subject: CheckedTask) -> Iterator[Violation]:
    """A viewpoint that is set is read back and seen by its camera alone, and a reset undoes it exactly."""
    cameras, start = _cameras(subject), subject.start(SEED)
    simulation, before = subject.reset(SEED), start.images
    turn = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    for camera in before:
        own = cameras.viewpoint(camera)
        asked = Viewpoint(own.position + 0.03, turn @ own.rotation, own.fovy + 0.1)
        cameras.set_viewpoint(camera, asked)
        found, after = cameras.viewpoint(camera), simulation.observe().images
        for part in ("position", "rotation", "fovy"):
            value = getattr(found, part)
            same = np.allclose(value, getattr(asked, part), atol=1e-5)
            yield from expect(same, f"{camera} to have the {part} that was set", np.round(value, 4))
        for other in before:
            share = changed(before[other], after[other], by=0)
            if other == camera:
                yield from expect(share >= 0.05, f"{camera} to show another image from there", "the same image")
            else:
                same_view = f"{other} to show the same when {camera} is moved"
                yield from expect(share == 0.0, same_view, f"{100 * share:.1f} % other pixels")
        yield from expect_restored(subject, start, f"all as before after a reset, once {camera} was moved")


CHECKS = (upright, viewpoint, place, aim, same_picture, adjusted)
