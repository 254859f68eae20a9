"""Runs in an environment with LeRobot's evaluation.

`evaluating.py FILE ARGUMENT...` is `lerobot-eval ARGUMENT...` and keeps the actions of its episodes in FILE, a list of
(1, steps, numbers).
"""

import sys

import numpy as np
from lerobot.scripts import lerobot_eval

FILE, PLAYED, ORIGINAL = sys.argv.pop(1), [], lerobot_eval.rollout


def noting(*arguments, **more):
    played = ORIGINAL(*arguments, **more)
    PLAYED.append(played["action"].numpy())
    return played


lerobot_eval.rollout = noting
lerobot_eval.main()
np.savez(FILE, *PLAYED)
