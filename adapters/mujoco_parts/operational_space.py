"""Operational space control (Khatib 1987) between MuJoCo's physics steps, compiled; for `control`.

As in robosuite, translation and rotation are apart:

    torques = J' [L_p (kp e_p - kd v); L_o (kp e_o - kd w)] + bias + N' M (10 (q0 - q) - 2 sqrt(10) dq)

with the tool's Jacobian J, its errors e and velocities v, w, the inertias L that it shows in translation and rotation,
the arm's joints q, its mass matrix M, the projector N to its null space, and the initial joints q0.

Equal bits need more than an equal formula. BLAS rounds differently for rows and columns, so arrays have the memory
layout of robosuite's, and what robosuite compiles is called, not written again.

Importing this module imports MuJoCo, numba and robosuite. numba keeps what it compiles in the user's cache, apart for
each pair of versions, as the environments of several simulators share this file.
An error inside MuJoCo, such as a full stack, ends the process: no Python is in between that could raise it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numba
import numpy as np
import platformdirs
import robosuite
from llvmlite.binding import load_library_permanently
from numba import types
from robosuite.utils.control_utils import nullspace_torques, opspace_matrices, orientation_error

from robogauntlet.adapters.contract import FloatArray

(LIBRARY,) = Path(mujoco.__file__).parent.glob("libmujoco*")
load_library_permanently(str(LIBRARY))
settings: Any = numba.config
if not settings.CACHE_DIR:
    versions = f"numba-{numba.__version__}-robosuite-{robosuite.__version__}"
    settings.CACHE_DIR = str(platformdirs.user_cache_path("robogauntlet") / versions)
POINTER = types.int64
STATE = (POINTER, POINTER)
"""A model and its data."""
step1 = types.ExternalFunction("mj_step1", types.void(*STATE))
step2 = types.ExternalFunction("mj_step2", types.void(*STATE))
site_jacobians = types.ExternalFunction("mj_jacSite", types.void(*STATE, POINTER, POINTER, types.int32))
full_mass_matrix = types.ExternalFunction("mj_fullM", types.void(POINTER, POINTER, POINTER))


class Goal(NamedTuple):
    """What the torques of one control step have in common: the tool's goal in the world, kp and kd (6,), and q0."""

    position: FloatArray
    rotation: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    initial_joints: FloatArray


class Arm(NamedTuple):
    """MuJoCo's state, and arrays to compute in."""

    model: int
    data: int
    packed_masses: int
    masses_out: int
    jacobians_out: tuple[int, int]
    """Addresses; of MuJoCo's mass matrix, and of the arrays of which `masses` and `jacobians` are views."""
    site: np.int32
    position: FloatArray
    rotation: FloatArray
    """The tool's number and pose in the world."""
    velocities: FloatArray
    """Of all degrees of freedom, (nv,)."""
    joints: FloatArray
    speeds: FloatArray
    bias: FloatArray
    control: FloatArray
    low: FloatArray
    high: FloatArray
    """Of the arm: positions, velocities, forces of gravity and motion, actuators and their range (Nm)."""
    grip: FloatArray
    """The gripper's actuators."""
    jacobians: FloatArray
    """Of the tool's translation and rotation, (2, 3, nv)."""
    arm_jacobians: FloatArray
    masses: FloatArray
    """Of the arm, (2, 3, joints), (joints, joints)."""
    j_pos: FloatArray
    j_rot: FloatArray
    j_full: FloatArray
    mass: FloatArray
    """Copies of them in robosuite's layout."""


@numba.njit(cache=True)
def torques_towards(goal: Any, arm: Any) -> Any:
    """Return the torques in MuJoCo's present state (Nm), (joints,)."""
    site_jacobians(arm.model, arm.data, arm.jacobians_out[0], arm.jacobians_out[1], arm.site)
    full_mass_matrix(arm.model, arm.masses_out, arm.packed_masses)
    j_pos, j_rot, j_full, mass = arm.j_pos, arm.j_rot, arm.j_full, arm.mass
    for joint in range(len(mass)):  # In slices, numba takes three seconds longer to compile them.
        for row in range(3):
            j_pos[row, joint] = j_full[row, joint] = arm.arm_jacobians[0, row, joint]
            j_rot[row, joint] = j_full[3 + row, joint] = arm.arm_jacobians[1, row, joint]
        for other in range(len(mass)):
            mass[joint, other] = arm.masses[joint, other]
    velocity, spin = np.dot(arm.jacobians[0], arm.velocities), np.dot(arm.jacobians[1], arm.velocities)
    force = (goal.position - arm.position) * goal.stiffness[:3] - velocity * goal.damping[:3]
    torque = orientation_error(goal.rotation, arm.rotation) * goal.stiffness[3:] - spin * goal.damping[3:]
    _, inertia, rotational_inertia, nullspace = opspace_matrices(mass, j_full, j_pos, j_rot)
    wrench = np.concatenate((np.dot(inertia, force), np.dot(rotational_inertia, torque)))
    idle = nullspace_torques(mass, nullspace, goal.initial_joints, arm.joints, arm.speeds)
    return np.dot(j_full.T, wrench) + arm.bias + idle


@numba.njit(cache=True)
def physics_steps(goal: Any, grip: Any, first: Any, arm: Any) -> None:
    """Run a physics step for each row of `grip` (physics steps, actuators), the commands to the gripper.

    The first step must have begun, by `mj_step1`; its torques are `first` unless that is empty.
    """
    for number in range(len(grip)):
        if number:
            step1(arm.model, arm.data)
        torques = first if number == 0 and len(first) else torques_towards(goal, arm)
        for joint in range(len(torques)):
            arm.control[joint] = np.minimum(np.maximum(torques[joint], arm.low[joint]), arm.high[joint])
        for finger in range(len(arm.grip)):
            arm.grip[finger] = grip[number, finger]
        step2(arm.model, arm.data)
