"""Cameras: images are upright and not mirrored, and the viewpoints that are told are those that are drawn from."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from adapters.adjusting import Cameras, Viewpoint
from adapters.contract import FloatArray, Image, Simulation
from adapters.viewpoints import seen_at_height
from orchestrator.conformance.findings import Fault, NotApplicable, check
from orchestrator.conformance.subject import SIZE, Subject, changed
from orchestrator.perturbations.cameras import BASE_HEIGHT, THIRD_PERSON

ANGLE = math.radians(8.0)
"""By which cameras are turned."""
LIKE = 0.5
"""Correlation with what the turned camera should show, at least."""
MOVED = 15
"""Difference of grey values by which a pixel shows motion."""
NEAR = 0.08
"""How far from where the fingers are, at most, motion is seen when they close (share of the image)."""
RAISED = 0.05
"""How far the tool is raised, twice (m)."""
SEED = 3
TURNS = ((1, 1.0), (1, -1.0), (0, 1.0), (0, -1.0))
"""To its right, to its left, upwards, downwards: axis of a camera (right, down, forward), sign of the turn about it."""
UPRIGHT = "upright"
DRAWN = {
    UPRIGHT: np.diag([1.0, 1.0, 1.0]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
    "upside down and mirrored": np.diag([1.0, -1.0, 1.0]),
    "turned round by half": np.diag([-1.0, -1.0, 1.0]),
}
"""How an image may lie on its pixels: flips of right and down."""


def _cameras(subject: Subject) -> Cameras:
    subject.reset()
    if subject.adjusters.cameras is None:
        raise NotApplicable("the adapter offers no camera poses (`adjusters.cameras`), so they cannot be compared")
    return subject.adjusters.cameras


def _grey(image: Image) -> FloatArray:
    return np.asarray(image, dtype=np.float64).mean(axis=2)


def _motion(before: Image, after: Image) -> NDArray[np.intp]:
    """Pixels (n, 2), as row and column, that show motion between two images."""
    return np.argwhere(np.abs(_grey(before) - _grey(after)) > MOVED)


@check("camera-upright", look="the rows of the images: OpenGL's and Bullet's buffers begin at the bottom", renders=True)
def upright(subject: Subject) -> Iterator[Fault]:
    """The third-person image is upright."""
    if THIRD_PERSON not in subject.view.cameras:
        raise NotApplicable("the third-person camera is not rendered")
    simulation = subject.reset()
    if (cameras := subject.adjusters.cameras) is not None:
        down = cameras.viewpoint(THIRD_PERSON).rotation[:, 1]
        if down[2] >= 0.0:
            yield Fault(
                "the image's down to point down in the base frame", f"it points to {np.round(down, 2).tolist()}"
            )
        return  # that images are drawn so is another check's affair
    images = [simulation.observe().images[THIRD_PERSON]]
    for _ in range(2):
        _raise_tool(subject, simulation)
        images.append(simulation.observe().images[THIRD_PERSON])
    first, second = (_motion(before, after) for before, after in pairwise(images))
    if len(first) == 0 or len(second) == 0:
        raise NotApplicable("the third-person camera does not see the tool rise")
    risen = float(np.median(first[:, 0]) - np.median(second[:, 0]))
    if risen < 0.0:
        yield Fault(
            "motion to go up in the third-person image as the tool goes up",
            f"it goes down by {-risen:.1f} of {subject.view.image_size} px",
        )


def _raise_tool(subject: Subject, simulation: Simulation) -> None:
    length = min(0.01, simulation.action_spec.max_translation)
    for _ in range(math.ceil(RAISED / length)):
        simulation.step(subject.action(dz=length))


@check("camera-viewpoint", look="`adjusters.cameras.viewpoint`: right, down, forward and fovy", renders=True)
def viewpoint(subject: Subject) -> Iterator[Fault]:
    """A camera that is turned, or has another lens, shows what the geometry of a pinhole says."""
    cameras = _cameras(subject)
    for camera in subject.view.cameras:
        own = cameras.viewpoint(camera)
        yield from _right_handed(camera, own)
        image = subject.simulation.observe().images[camera]
        cameras.set_viewpoint(camera, own)
        if (share := changed(image, subject.simulation.observe().images[camera])) > 0.02:
            yield Fault(f"{camera}, set to its own viewpoint, to show the own image", f"{share:.0%} other pixels")
        before = _smooth(image)
        likenesses: dict[str, list[float]] = {drawn: [] for drawn in DRAWN}
        for axis, sign in TURNS:
            turn = Rotation.from_rotvec(sign * ANGLE * np.eye(3)[axis]).as_matrix()
            seen = _shown(subject, cameras, camera, replace(own, rotation=own.rotation @ turn))
            for drawn, flip in DRAWN.items():
                likenesses[drawn].append(_likeness(seen, before, _homography(own.fovy, own.fovy, flip @ turn @ flip)))
        like = {drawn: float(np.mean(found)) for drawn, found in likenesses.items()}
        best = max(like, key=lambda drawn: like[drawn])
        told = f"{camera}, turned by {math.degrees(ANGLE):g} deg, to show the same things moved accordingly"
        if best != UPRIGHT:
            numbers = f"correlation {like[best]:.2f}, else {like[UPRIGHT]:.2f}"
            yield Fault(told, f"they move as in an image that is {best} ({numbers})")
        elif like[best] < LIKE:
            yield Fault(told, f"they do not (correlation {like[best]:.2f}, expected {LIKE:g})")
        wider = own.fovy + ANGLE
        seen = _shown(subject, cameras, camera, replace(own, fovy=wider))
        found, same = (_likeness(seen, before, _homography(own.fovy, to, np.eye(3))) for to in (wider, own.fovy))
        if found < max(LIKE, same):
            numbers = f"correlation {found:.2f} with that, {same:.2f} with no change"
            yield Fault(f"{camera} to show things smaller with a wider fovy (vertical, rad)", numbers)
        subject.reset()


def _right_handed(camera: str, own: Viewpoint) -> Iterator[Fault]:
    if not np.allclose(own.rotation.T @ own.rotation, np.eye(3), atol=1e-4) or np.linalg.det(own.rotation) < 0.0:
        yield Fault(
            f"a right-handed rotation (right, down, forward) of {camera}", f"{np.round(own.rotation, 2).tolist()}"
        )


def _shown(subject: Subject, cameras: Cameras, camera: str, viewpoint: Viewpoint) -> FloatArray:
    cameras.set_viewpoint(camera, viewpoint)
    return _smooth(subject.simulation.observe().images[camera])


def _smooth(image: Image) -> FloatArray:
    """Grey values without what a pixel's share decides."""
    return np.asarray(gaussian_filter(_grey(image), SIZE / 64))


def _homography(fovy: float, to_fovy: float, turn: FloatArray) -> FloatArray:
    """Takes directions of the turned camera's pixels to the own camera's: K R K'^-1 (Hartley and Zisserman, 8.4.2).

    Pixels are in units of half the image, from its centre, to the right and down.
    """
    own, other = (np.diag([1.0 / math.tan(f / 2.0)] * 2 + [1.0]) for f in (fovy, to_fovy))
    return own @ turn @ np.linalg.inv(other)


def _likeness(seen: FloatArray, before: FloatArray, homography: FloatArray) -> float:
    """Correlation of an image with an earlier one, moved by a homography, where they overlap."""
    size = len(seen)
    along = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    right, down = np.meshgrid(along, along)
    x, y, z = homography @ np.stack([right.ravel(), down.ravel(), np.ones(size * size)])
    columns, rows = ((part / z + 1.0) / 2.0 * size - 0.5 for part in (x, y))
    inside = (z > 0) & (columns >= 0) & (columns <= size - 1) & (rows >= 0) & (rows <= size - 1)
    moved = map_coordinates(before, [rows[inside], columns[inside]], order=1)
    return float(np.corrcoef(moved, seen.ravel()[inside])[0, 1])


@check("camera-place", look="`adjusters.cameras.viewpoint` (base frame, m) and tcp_position", renders=True)
def place(subject: Subject) -> Iterator[Fault]:
    """The tool is seen where the third-person camera's viewpoint says: it moves there when the fingers close."""
    cameras = _cameras(subject)
    if THIRD_PERSON not in subject.view.cameras:
        raise NotApplicable("the third-person camera is not rendered")
    if subject.ignores("gripper"):
        raise NotApplicable("the gripper does nothing in this task, so it cannot be told from the arm")
    simulation = subject.simulation
    for _ in range(10):
        simulation.step(subject.action())
    before = simulation.picture()
    for _ in range(10):
        simulation.step(subject.action(gripper=1.0))
    motion = _motion(before, simulation.picture())
    if len(motion) == 0:
        raise NotApplicable("the third-person camera does not see the fingers close")
    row, column = pixel(cameras.viewpoint(THIRD_PERSON), simulation.privileged_state()["tcp_position"], len(before))
    seen_row, seen_column = np.median(motion, axis=0)
    if math.hypot(seen_row - row, seen_column - column) > NEAR * len(before):
        yield Fault(
            f"the fingers to close near row {row:.0f}, column {column:.0f} of the picture, where tcp_position projects",
            f"motion around row {seen_row:.0f}, column {seen_column:.0f}",
        )


def pixel(viewpoint: Viewpoint, point: FloatArray, size: int) -> tuple[float, float]:
    """Row and column at which a point (3,) in the viewpoint's frame appears in an image of `size` px."""
    right, down, forward = viewpoint.rotation.T @ (np.asarray(point) - viewpoint.position)
    scale = size / 2.0 / math.tan(viewpoint.fovy / 2.0) / forward
    return float(size / 2.0 + down * scale), float(size / 2.0 + right * scale)


@check("camera-aim", look="where the third-person camera stands: perturbations carry it round what it is aimed at")
def aim(subject: Subject) -> Iterator[Fault]:
    """The third-person camera is aimed at the table in front of the robot."""
    if THIRD_PERSON not in subject.view.cameras:
        raise NotApplicable("the third-person camera is not rendered")
    own = _cameras(subject).viewpoint(THIRD_PERSON)
    x, y, _ = seen_at_height(own, BASE_HEIGHT)
    if not (0.3 < x < 0.9 and abs(y) < 0.2):
        yield Fault(
            "an optical axis that meets the base's height at x 0.3 to 0.9, y within 0.2 m", f"({x:.2f}, {y:.2f}) m"
        )
    if not math.radians(20.0) < own.fovy < math.radians(75.0):
        yield Fault("a vertical field of view of 20 to 75 deg", f"{math.degrees(own.fovy):.0f} deg")


@check("camera-picture", look="Simulation.picture: the third-person view, at 256 px", renders=True)
def same_picture(subject: Subject) -> Iterator[Fault]:
    """The picture for people shows what the third-person camera shows."""
    simulation = subject.reset()
    if THIRD_PERSON not in subject.view.cameras:
        raise NotApplicable("the third-person camera is not rendered")
    seen, shown = _smooth(simulation.observe().images[THIRD_PERSON]), _smooth(simulation.picture())
    along = (np.arange(len(seen)) + 0.5) / len(seen) * len(shown) - 0.5
    small = map_coordinates(shown, np.meshgrid(along, along, indexing="ij"), order=1)
    like = float(np.corrcoef(small.ravel(), seen.ravel())[0, 1])
    if like < 0.8:
        yield Fault("the picture to look like the third-person image, correlation 0.8 at least", f"{like:.2f}")


@check("camera-adjusted", look="`adjusters.cameras.set_viewpoint` and reset", renders=True)
def adjusted(subject: Subject) -> Iterator[Fault]:
    """A viewpoint that is set is read back and seen by its camera alone, and a reset undoes it to the bit."""
    cameras, start = _cameras(subject), subject.start(SEED)
    simulation, before = subject.reset(SEED), start.images
    turn = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    for camera in before:
        own = cameras.viewpoint(camera)
        asked = Viewpoint(own.position + 0.03, turn @ own.rotation, own.fovy + 0.1)
        cameras.set_viewpoint(camera, asked)
        found, after = cameras.viewpoint(camera), simulation.observe().images
        for part in ("position", "rotation", "fovy"):
            if not np.allclose(getattr(found, part), getattr(asked, part), atol=1e-5):
                yield Fault(f"{camera} to have the {part} that was set", str(np.round(getattr(found, part), 4)))
        for other in before:
            share = changed(before[other], after[other], by=0)
            if other == camera and share < 0.05:
                yield Fault(f"{camera} to show something else from there", "the same image")
            if other != camera and share > 0.0:
                yield Fault(f"{other} to show the same when {camera} is moved", f"{100 * share:.1f} % other pixels")
        subject.reset(SEED)
        for difference in subject.differences(start):
            yield Fault(f"all as before after a reset, once {camera} was moved", difference)


CHECKS = (upright, viewpoint, place, aim, same_picture, adjusted)
