"""A distribution of several versions, and simulators that report which one they have."""

import zipfile

ADAPTER = """
from robogauntlet.adapters.contract import Simulator, TaskDescription
from robogauntlet.adapters.null import NullSimulation


class GearboxSimulation(NullSimulation):
    def render_device(self):
        import gearbox

        return f"gearbox {gearbox.VERSION}"


def simulator(name, requirements=()):
    return Simulator(
        name=name, title=name, tasks={"Reach": TaskDescription("reach the goal", 20)}, modules=("gearbox",),
        distributions=("gearbox",), open=GearboxSimulation, requirements=requirements, renders=False,
    )


FIRST, SECOND, BARE = simulator("first", ("gearbox==1.0",)), simulator("second", ("gearbox==2.0",)), simulator("bare")
"""
TARGETS = "".join(f"{name} = toy_simulators:{name.upper()}\n" for name in ("first", "second", "bare"))
ENTRY_POINTS = f"[robogauntlet.simulators]\n{TARGETS}"


def write_wheel(folder, version):
    about = f"Metadata-Version: 2.1\nName: gearbox\nVersion: {version}\n"
    information = f"gearbox-{version}.dist-info"
    files = {
        "gearbox.py": f'VERSION = "{version}"\n',
        f"{information}/METADATA": about,
        f"{information}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    files[f"{information}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{information}/RECORD"])
    with zipfile.ZipFile(folder / f"gearbox-{version}-py3-none-any.whl", "w") as wheel:
        for name, text in files.items():
            wheel.writestr(name, text)


def write_adapter(folder):
    information = folder / "toy_simulators-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-simulators\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(ENTRY_POINTS)
    (folder / "toy_simulators.py").write_text(ADAPTER)
