"""The manifest and the image recipe for KubeRay: valid, and in agreement. Nothing here runs Kubernetes."""

import copy
import fnmatch
import json
import re
import shlex
import tomllib

import pytest
import typer
import yaml

from tests import ROOT

jsonschema = pytest.importorskip("jsonschema")
FOLDER = ROOT / "examples" / "kuberay"
TEXT = (FOLDER / "raycluster.yaml").read_text(encoding="utf-8")
RECIPE = (FOLDER / "Containerfile").read_text(encoding="utf-8")
DOCUMENTS = {document["kind"]: document for document in yaml.safe_load_all(TEXT)}
WHEELS = ("robogauntlet", "robogauntlet_mergevla", "robogauntlet_zoo")
SCHEMA = json.loads((ROOT / "tests" / "data" / "kuberay.schema.json").read_text())
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def validate(document):
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(document, SCHEMA)


def pods():
    spec = DOCUMENTS["RayCluster"]["spec"]
    return [group["template"]["spec"] for group in (spec["headGroupSpec"], *spec["workerGroupSpecs"])]


def containers():
    return [container for pod in pods() for container in pod["containers"]]


def instructions(name):
    joined = RECIPE.replace("\\\n", " ")
    return [line.partition(" ")[2] for line in joined.splitlines() if line.startswith(f"{name} ")]


def copied():
    """The files of the repository that the recipe copies."""
    return [word for line in instructions("COPY") if "--from" not in line for word in line.split()[:-1]]


@pytest.mark.parametrize("kind", ["RayCluster", "PersistentVolumeClaim", "NetworkPolicy"])
def test_the_manifest_is_valid(kind):
    validate(DOCUMENTS[kind])


@pytest.mark.parametrize(
    "path",
    [
        "spec/workerGroups",
        "spec/headGroupSpec/template/spec/container",
        "spec/headGroupSpec/template/spec/securityContext/runAsNonroot",
    ],
)
def test_the_schema_finds_a_misspelt_field(path):
    document = copy.deepcopy(DOCUMENTS["RayCluster"])
    *way, name = path.split("/")
    place = document
    for key in way:
        place = place[key]
    place[name] = True
    with pytest.raises(jsonschema.ValidationError):
        validate(document)


def test_every_pod_gets_rays_token_from_one_secret_that_the_comment_makes():
    for container in containers():
        variables = {variable["name"]: variable for variable in container["env"]}
        assert variables["RAY_AUTH_MODE"]["value"] == "token"
        secret = variables["RAY_AUTH_TOKEN"]["valueFrom"]["secretKeyRef"]
        assert f"kubectl create secret generic {secret['name']} --from-literal={secret['key']}=" in TEXT


def test_only_pods_of_the_cluster_reach_its_pods():
    label = {"ray.io/cluster": DOCUMENTS["RayCluster"]["metadata"]["name"]}
    policy = DOCUMENTS["NetworkPolicy"]["spec"]
    assert policy["podSelector"]["matchLabels"] == label
    assert [source["podSelector"]["matchLabels"] for rule in policy["ingress"] for source in rule["from"]] == [label]


def test_user_and_group_are_those_of_the_image_and_not_root():
    (user,) = instructions("USER")
    assert f"useradd --uid {user} " in RECIPE
    for pod in pods():
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert str(pod["securityContext"]["runAsUser"]) == user != "0"
        assert pod["securityContext"]["fsGroup"] == pod["securityContext"]["runAsGroup"]
    assert all(item["securityContext"]["capabilities"] == {"drop": ["ALL"]} for item in containers())


def test_the_run_folder_is_a_volume_at_a_path_that_the_image_has():
    head = pods()[0]
    (mount,) = head["containers"][0]["volumeMounts"]
    assert f"install -d -o robogauntlet -g robogauntlet {mount['mountPath']}" in RECIPE
    (volume,) = head["volumes"]
    assert volume["name"] == mount["name"]
    assert volume["persistentVolumeClaim"]["claimName"] == DOCUMENTS["PersistentVolumeClaim"]["metadata"]["name"]
    assert set(re.findall(r"--out (/\w+)", TEXT)) == {mount["mountPath"]}


def test_the_images_name_and_rays_version_are_those_of_this_version():
    image = f"{PROJECT['name']}:{PROJECT['version']}"
    assert {container["image"] for container in containers()} == {image}
    assert f"-t {image} ." in RECIPE
    assert f"ray=={DOCUMENTS['RayCluster']['spec']['rayVersion']}" in (ROOT / "constraints.txt").read_text().split()


def test_the_command_of_the_comment_is_one_of_the_command_line():
    from robogauntlet.orchestrator.cli import app

    (line,) = re.findall(r"kubectl exec .* -- robogauntlet run (.*)", TEXT)
    command = typer.main.get_command(app).get_command(None, "run")
    values = command.make_context("run", shlex.split(line)).params
    assert values["address"] == f"{DOCUMENTS['RayCluster']['metadata']['name']}-head-svc:6379"
    assert containers()[0]["ports"] == [{"name": "gcs-server", "containerPort": 6379}]


def test_the_image_is_made_of_wheels_extras_and_scripts_that_exist():
    (extras,) = re.findall(r"^ARG EXTRAS=(.*)$", RECIPE, re.MULTILINE)
    assert set(extras.split(",")) <= PROJECT["optional-dependencies"].keys()
    names = [f"{name}-{PROJECT['version']}-py3-none-any.whl" for name in WHEELS]
    patterns = re.findall(r"/build/(robogauntlet\S*\.whl)", RECIPE)
    assert [[name for name in names if fnmatch.fnmatch(name, pattern)] for pattern in patterns] == [[n] for n in names]
    assert [word for word in copied() if "*" not in word and not (ROOT / word).is_file()] == []


def test_the_environment_finds_the_interpreter_that_made_it_in_the_image():
    made_in, played_in = RECIPE.split("\nFROM ${BASE}")[1:]
    assert " python3-venv\n" in made_in
    assert "RUN python3 -m venv /opt/robogauntlet\n" in made_in
    assert " python3 wget " in played_in
    assert "COPY --from=packages /opt/robogauntlet /opt/robogauntlet\n" in played_in


def test_the_build_sees_what_it_copies_and_nothing_else():
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    allowed = {line[1:] for line in lines if line.startswith("!")}
    assert "*" in lines
    assert {word for word in copied() if "*" not in word} == {name for name in allowed if "*" not in name}
    assert all(fnmatch.fnmatch(name, "dist/*.whl") for name in allowed if "*" in name)


def test_no_registry_is_named():
    images = re.findall(r"^ARG BASE=(\S+)$", RECIPE, re.MULTILINE) + [item["image"] for item in containers()]
    assert [image for image in images if "/" in image] == []
