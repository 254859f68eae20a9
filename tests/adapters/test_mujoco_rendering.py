"""What is said where MuJoCo cannot render fits the variables that are set."""

import pytest

from robogauntlet.adapters import mujoco_scene


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"MUJOCO_GL": "glfw"}, "MUJOCO_GL=glfw (no): unset MUJOCO_GL, which is then egl and needs no screen"),
        (
            {"MUJOCO_GL": "egl", "MUJOCO_EGL_DEVICE_ID": "0", "CUDA_VISIBLE_DEVICES": "1,10"},
            "MUJOCO_EGL_DEVICE_ID=0 is not among CUDA_VISIBLE_DEVICES=1,10; set it to one of them, or unset it",
        ),
        (
            {"MUJOCO_GL": "egl", "MUJOCO_EGL_DEVICE_ID": "7"},
            "MUJOCO_GL=egl (no): unset MUJOCO_EGL_DEVICE_ID=7, or set it to the number of a device",
        ),
        ({"MUJOCO_GL": "egl", "CUDA_VISIBLE_DEVICES": "1"}, "install the Debian packages libegl1, "),
        ({"MUJOCO_GL": "osmesa", "MUJOCO_EGL_DEVICE_ID": "7"}, "install the Debian packages libegl1, "),
    ],
)
def test_advice_fits_the_variables_that_are_set(monkeypatch, variables, said):
    for name in ("MUJOCO_EGL_DEVICE_ID", "CUDA_VISIBLE_DEVICES"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(mujoco_scene, "_chosen", {"MUJOCO_GL": variables["MUJOCO_GL"]})
    monkeypatch.setenv("MUJOCO_GL", "egl")  # robosuite overwrites it
    message = str(mujoco_scene.no_rendering(RuntimeError("\n no.\n")))
    assert said in message
    assert "\n" not in message
