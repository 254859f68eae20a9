"""Tests of the policy that need no simulator."""

import numpy as np
from toypolicy import Toypolicy

BLACK = {camera: np.zeros((96, 96, 3), np.uint8) for camera in ("third_person", "wrist")}
STATE = np.array([0.4, 0.0, 0.2, np.pi, 0.0, 0.0, 0.04, 0.04])


def with_red_at(row: int, column: int) -> dict[str, np.ndarray]:
    """Black images, with a red spot in that of the wrist camera."""
    wrist = np.zeros((96, 96, 3), np.uint8)
    wrist[row - 3 : row + 3, column - 3 : column + 3, 0] = 255
    return {**BLACK, "wrist": wrist}


def test_it_answers_with_actions_of_seven_numbers() -> None:
    actions = Toypolicy()(BLACK, STATE, "reach the red ball")
    assert actions.ndim == 2
    assert actions.shape[1] == 7
    assert np.isfinite(actions).all()
    assert np.abs(actions[:, :3]).max() <= 0.03, "metres per control step"


def test_it_moves_to_what_is_red() -> None:
    assert Toypolicy()(with_red_at(80, 48), STATE, "")[0, 0] > 0, "forward"
    assert Toypolicy()(with_red_at(48, 80), STATE, "")[0, 1] > 0, "left"


def test_reset_forgets_the_last_episode() -> None:
    policy = Toypolicy()
    policy(with_red_at(80, 48), STATE, "")
    policy.reset()
    assert np.array_equal(policy(BLACK, STATE, ""), Toypolicy()(BLACK, STATE, ""))
