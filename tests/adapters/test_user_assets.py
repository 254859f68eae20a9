"""Assets of the user's: where they are looked for, their hash, and what ManiSkill leaves out without them."""

import json
import shutil

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import TaskUnavailable
from robogauntlet.adapters.maniskill import assets as of_maniskill
from robogauntlet.adapters.maniskill.assets import YCB, YCB_INFO, check_assets, described
from robogauntlet.adapters.user_assets import content_hash, variable
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.results.api import open_run
from robogauntlet.suites.environments import Config
from tests.errors import one_line_error
from tests.processes import run_gauntlet

TASK = "PickSingleYCB-v1@Panda-joint-delta"
CORNERS = [(x, y, z) for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.025, 0.025)]
"""Of a box (m)."""
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4)]
FACES += [(1, 5, 7), (1, 7, 3)]
PLY = """ply
format ascii 1.0
element vertex 8
property float x
property float y
property float z
element face 12
property list uchar int vertex_indices
end_header
"""


def ycb(folder, names=("001_box", "002_box")):
    """A folder as that of ManiSkill's downloads, with boxes."""
    for name in names:
        model = folder / YCB / "models" / name
        model.mkdir(parents=True)
        lines = [f"{x} {y} {z}\n" for x, y, z in CORNERS]
        (model / "collision.ply").write_text(PLY + "".join(lines + [f"3 {a} {b} {c}\n" for a, b, c in FACES]))
        faces = [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES]
        (model / "textured.obj").write_text("".join([f"v {line}" for line in lines] + faces))
    box = {"bbox": {"min": CORNERS[0], "max": CORNERS[-1]}, "density": 500, "scales": [1.0]}
    (folder / YCB_INFO).write_text(json.dumps(dict.fromkeys(names, box)))
    return folder


@pytest.fixture
def named(monkeypatch, tmp_path):
    """The folder that is named for ManiSkill, which is not there."""
    monkeypatch.setenv(variable("maniskill"), str(tmp_path / "mine"))
    content_hash.cache_clear()
    yield tmp_path / "mine"
    content_hash.cache_clear()


def test_another_content_is_another_hash_wherever_the_folder_is(tmp_path):
    hashes = {}
    for name, text in {"one": "abc", "same": "abc", "other": "abd"}.items():
        (tmp_path / name / "b").mkdir(parents=True)
        (tmp_path / name / "b" / "x.obj").write_text(text)
        hashes[name] = content_hash(tmp_path / name)
    assert hashes["one"] == hashes["same"] != hashes["other"]
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "b").symlink_to(tmp_path / "one" / "b")
    (tmp_path / "one" / "b" / "round").symlink_to(tmp_path / "one")
    assert content_hash(tmp_path / "linked", ("b",)) == hashes["one"]


def test_workers_get_the_folder_of_the_configuration_unless_a_variable_is_set(monkeypatch):
    monkeypatch.delenv(variable("libero-plus"), raising=False)
    monkeypatch.setenv(variable("maniskill"), "/of/variable")
    config = Config(assets={"maniskill": "/of/file", "libero-plus": "/of/file"})
    _, variables = EnvironmentResolver({}, config).subprocess_env(catalog.find("maniskill"))
    assert variables["ROBOGAUNTLET_MANISKILL_ASSETS"] == "/of/variable"
    assert variables["ROBOGAUNTLET_LIBERO_PLUS_ASSETS"] == "/of/file"
    variables = EnvironmentResolver({}, config).ray_runtime_env(catalog.find("maniskill"))["env_vars"]
    assert variables["ROBOGAUNTLET_MANISKILL_ASSETS"] == "/of/variable"


def test_maniskills_own_variable_is_the_second_choice(monkeypatch, named):
    assert of_maniskill.assets_folder() == named
    monkeypatch.delenv(variable("maniskill"))
    monkeypatch.setenv("MS_ASSET_DIR", "/theirs")
    assert str(of_maniskill.assets_folder()) == "/theirs"


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda folder: None, "mine does not exist"),
        (lambda folder: folder.touch(), "mine is a file, expected a folder"),
        (lambda folder: folder.mkdir(), f"mine lacks {YCB_INFO}"),
        (
            lambda folder: shutil.rmtree(ycb(folder) / YCB / "models" / "002_box"),
            f"mine lacks {YCB}/models/002_box/collision.ply and 1 more",
        ),
        (lambda folder: (ycb(folder) / YCB_INFO).write_text("[1"), "expected ManiSkill's list of objects in "),
        (lambda folder: (ycb(folder) / YCB_INFO).write_text("3"), "expected ManiSkill's list of objects in "),
    ],
)
def test_a_task_without_its_files_is_left_out_in_one_line_and_the_others_are_not(named, make, says):
    make(named)
    with one_line_error(TaskUnavailable) as caught:
        check_assets(TASK)
    assert says in str(caught.value)
    check_assets("PushCube-v1")


def test_the_device_says_the_hash_of_the_files_that_tasks_need(named):
    assert described("llvmpipe") == "llvmpipe"
    ycb(named)
    (named / "demos").mkdir()
    (named / "demos" / "unused").touch()
    check_assets(TASK)
    assert described("llvmpipe") == f"llvmpipe, assets {content_hash(named, (YCB,))}"


@pytest.mark.nightly
@pytest.mark.simulator
@pytest.mark.ray
def test_a_task_is_left_out_until_its_files_are_there_and_other_files_make_another_run(tmp_path):
    (tmp_path / "config.yaml").write_text(f"assets: {{maniskill: {tmp_path / 'mine'}}}\n")
    variables = {"ROBOGAUNTLET_CONFIG": str(tmp_path / "config.yaml"), "OMP_NUM_THREADS": "1"}

    def play(out, *more):
        asked = ["--policy", "random", "--task", f"maniskill/{TASK}", "--task", "maniskill/PushT-v1@PandaStick"]
        done = run_gauntlet("run", *asked, "--seeds", "2", "--out", out, "--no-media", *more, cwd=tmp_path, **variables)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        return done.stdout, list(open_run(tmp_path / out).episodes().sort_values("task").status)

    said, statuses = play("one")
    line = f"2 episodes left out: it needs ManiSkill's files of the YCB objects: {tmp_path / 'mine'} does not exist"
    assert line in " ".join(said.split())
    assert statuses == ["error"] * 2 + ["failure"] * 2
    ycb(tmp_path / "mine")
    assert play("one", "--retry-errors")[1] == ["failure"] * 4
    (tmp_path / "mine" / YCB / "models" / "001_box" / "textured.obj").open("a").write("# another\n")
    play("two")
    compared = run_gauntlet("compare", "one", "two", cwd=tmp_path, **variables)
    assert "renderer differs: maniskill rendered on " in " ".join(compared.stdout.split())
