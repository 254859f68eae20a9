"""Suite files with a wrong value at each key, with names that do not exist, and with text that is no suite."""

import pytest

from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.suites.loading import SuiteError, load_suite
from tests.bad_input.refusals import not_refused

KNOWN = load_registry()
BASE = {"name": "s", "policies": "[random, zero]", "tasks": "[null/Reach]", "seeds": "{count: 2}"}
TEXT = "x" * 10_001
NOT_WHOLE = {
    "many": "expected a valid integer, found text ('many')",
    "2.5": "expected a valid integer, found a number (2.5)",
    "true": "expected a valid integer, found true/false (True)",
    "-1": "expected a value greater than or equal to",
    "1000000000000000000": "expected a value less than or equal to",
}
NOT_A_NUMBER = {
    "much": "expected a valid number, found text ('much')",
    ".nan": "found nan",
    "-1": "expected a value greater than",
    "1e300": "expected a value less than",
}
NOT_A_NAME = {
    "a b": "expected letters, digits, '.', '_' or '-', starting with a letter or digit; found 'a b'",
    "../s": "expected letters, digits",
    "é": "expected letters, digits",
    "5": "expected a valid string, found a whole number (5)",
    "y" * 81: "expected at most 80 characters, found text",
}
WHOLE = {  # key to how its value is written
    **dict.fromkeys(("horizon", "replan_every", "image_size", "max_attempts"), "{}"),
    "workers": "{{'null': {}}}",
    "seeds.count": "{{count: {}}}",
    "seeds.start": "{{count: 1, start: {}}}",
    "inference.batch": "{{batch: {}}}",
    "inference.replicas": "{{replicas: {}}}",
    "adaptive.round": "{{max_seeds: 9, round: {}}}",
    "adaptive.max_seeds": "{{max_seeds: {}}}",
}
NUMBERS = {
    **dict.fromkeys(("episode_time_limit_s", "error_tolerance"), "{}"),
    **{f"resources.{key}": f"{{{{'null': {{{{{key}: {{}}}}}}}}}}" for key in ("num_cpus", "num_gpus", "memory_gb")},
    "inference.wait_ms": "{{wait_ms: {}}}",
    "inference.num_gpus": "{{num_gpus: {}}}",
    "adaptive.alpha": "{{max_seeds: 9, alpha: {}}}",
    "regression.alpha": "{{alpha: {}}}",
    "regression.margin": "{{margin: {}}}",
}
NAMES = {"name": "{}", "policies.1.name": "[{{kind: random, name: {}}}]", "oracle_gate": "{}"}
OTHERS = {
    "description": {TEXT: "expected at most 10000 characters, found text"},
    "needs": {
        "robot": "expected 'policy', found 'robot'",
        "policy": "'random': expected none but those of oracle_gate\n'zero': expected none but those of oracle_gate",
    },
    "policies": {
        "[]": "expected at least one entry, found an empty list",
        "random": "expected a list, found text ('random')",
        "[5]": "policies.1: expected a mapping, found a whole number (5)",
        "[{name: mine}]": "missing key 'kind'",
        f"[{'y' * 5_000}]": "name: expected at most 80 characters",
        "[randm]": "unknown policy 'randm'; did you mean 'random'?",
        "[random, random]": "duplicate policy 'random', already at entry 1",
        "[{kind: random, optoins: {}}]": "unknown key 'optoins'; did you mean 'options'?",
        "[{kind: random, options: {sead: 1}}]": "policy 'random' has no option 'sead'",
        "[{kind: lerobot, options: {checkpoint: x, python: /bin/sh}}]": "a suite names no program",
        "[{kind: openpi, options: {adress: x}}]": "policy 'openpi' has no option 'adress'; did you mean 'address'?",
    },
    "tasks": {
        f"[null/{'y' * 9_000}]": "unknown task 'null/yyy",
        f"[{TEXT}]": "expected at most 10000 characters, found text",
        "[null/Reech]": "unknown task 'null/Reech'; did you mean 'null/Reach'?",
        "[nul/Reach]": "unknown simulator 'nul' in 'nul/Reach'",
        "[Reach]": "expected simulator/task, got 'Reach'",
        "[null/Reach, null/Reach]": "duplicate task 'null/Reach'",
        '["null/\\u202eReach"]': "unknown task 'null/\\u202eReach'; did you mean",
    },
    "conditions": {
        "[noise]": "expected severities above 0 for 'noise'\nno clean condition",
        "[clean, nois]": "unknown condition 'nois'; did you mean 'noise'?",
        "[clean, clean]": "duplicate condition 'clean'",
        "[{axis: noise, severities: [1]}]": "no clean condition to compare the perturbed ones with; add clean",
        "[clean, {axis: noise, severities: [6]}]": "expected a value less than or equal to 5, found 6",
        "[clean, {axis: noise, severity: [1]}]": "missing key 'severities'\nunknown key 'severity'; did you mean",
        f"[clean, {{axis: {'y' * 9_000}, severities: [1]}}]": "unknown condition 'yyy",
        "[{axis: clean, severities: [1]}]": "clean has severity 0 only\nno clean condition",
        "[clean, {axis: again, severities: [2]}]": "'again' has severity 1 at most, got 2",
        "[clean, {axis: noise, severities: [x]}]": "severities.1: expected a valid number, found text ('x')",
        "[clean, {noise: 2, table: 6}]": "conditions.2: expected a severity above 0 and up to 5 for 'table', got 6",
        "[clean, {noise: 0, table: 1}]": "expected a severity above 0 and up to 5 for 'noise', got 0",
        "[clean, {noise: 2, tabel: 1}]": "unknown condition 'tabel'; did you mean 'table'?",
        "[clean, {axis: noise@inf, severities: [1]}]": "expected a combination such as camera-orbit@2",
        "[clean, {axis: noise, severities: [1.001, 1.002]}]": "got 1.001\ngot 1.002",
        "[clean, noise@1.005]": "conditions.2: expected a severity in hundredths, such as 1, got 1.005",
        "[clean, 'noise:2']": "conditions.2: expected noise@2, got 'noise:2'",
        "[clean, {blind: 1, noise: 2}]": "the control 'blind' does not combine with others",
        "[clean, {distractors: 1.5, noise: 2}]": "'distractors' has whole severities only, got 1.5",
    },
    "design": {
        "noise": "design: expected a mapping, found text ('noise')",
        "{kind: lhs, axes: [noise]}": "expected 'one-at-a-time', 'grid', 'latin-hypercube' or 'sobol', found 'lhs'",
        "{kind: grid, axes: [nose]}": "unknown axis 'nose'; did you mean 'noise'?",
        "{kind: grid, axes: [noise], points: 8}": "design: expected no 'points' for kind grid, got 8",
        "{kind: grid, axes: [distractors, noise], severities: [1.5]}": "'distractors' has whole severities only",
        "{kind: grid, axes: [noise], severities: [1, 1]}": "design: expected each severity once, got 1 twice",
        "{kind: grid, axes: [noise], severities: [1.005]}": "in hundredths, such as 1, got 1.005",
        "{kind: sobol, axes: [noise], points: 4, max_severity: 4.996}": "in hundredths, such as 5, got 4.996",
        "{kind: sobol, axes: [distractors], points: 4, max_severity: 0.5}": "max_severity from 1",
        "{kind: grid, axes: [a+b, noise]}": "expected the name of an axis, got 'a+b'",
    },
    "seeds": {
        "{count: 1:30}": "expected a decimal number, or text in quotes; found 1:30, which YAML converts",
        "{count: 010}": "expected a decimal number, or text in quotes; found 010, which YAML converts",
        "{cuont: 1}": "missing key 'count'\nunknown key 'cuont'; did you mean 'count'?",
    },
    "cameras": {
        "[wirst]": "unknown camera 'wirst'; did you mean 'wrist'?",
        "[wrist, wrist]": "duplicate camera 'wrist'",
    },
    "render_profile": {"slow": "expected 'standard', 'fast' or 'fast-2', found 'slow'"},
    "protocol": {"openvla": "expected openvla with tasks of LIBERO only, got null/Reach; leave it out"},
    "success": {"twice": "expected 'held' or 'once', found 'twice'"},
    "workers": {
        "many": "expected 'auto', found 'many'",
        f"{{{'y' * 1_000}: 2}}": "unknown simulator 'yyy",
        "{nul: 2}": "unknown simulator 'nul'",
        "[2]": "workers: expected a valid integer, found a list",
        "0": "expected a value greater than or equal to 1, found 0",
    },
    "resources": {
        "{nul: {num_cpus: 1}}": "unknown simulator 'nul'",
        "{'null': {num_cpus: 1, memory: 2}}": "unknown key 'memory'; did you mean 'memory_gb'?",
    },
    "environments": {
        "{'null': {interpreter: /bin/sh}}": "a suite names no program",
        "{'null': {without_dependencies: ['==1']}}": "expected a requirement of pip",
        "{nul: {python: '3.11'}}": "unknown simulator 'nul'",
    },
    "inference": {
        "cloud": "expected 'worker', 'served' or 'auto', found 'cloud'",
        "{plaec: worker}": "unknown key 'plaec'; did you mean 'place'?",
    },
    "episode_time_limit_s": {"1.0e-300": "expected a value greater than or equal to 1, found 1e-300"},
    "oracle_gate": {"zero": "expected an oracle, 'zero' is a baseline without skill"},
    "no_skill_baselines": {
        "[random, zero]": "no_skill_baselines: expected a policy beside the baselines, got none",
        "[oracle]": "no_skill_baselines names no policy of this suite: 'oracle'",
    },
    "merging": {
        "{}": "missing key 'expert'\nmissing key 'oracle_routed'\nmissing key 'routed'",
        "{expert: a, oracle_routed: b, routed: [c]}": "no policy of this suite: 'a'\nsuite: 'b'\nsuite: 'c'",
    },
    "compare": {
        "{baseline: random}": "missing key 'others'",
        "{baseline: random, others: [zero], margin: 2}": "compare.margin: expected a value less than 1, found 2",
        "{baseline: random, others: [zero], margin: 0}": "compare.margin: expected a value greater than 0, found 0",
        "{baseline: random, others: [random]}": "compare names policy 'random' twice; each side is another policy",
        "{baseline: random, others: [zeor]}": "compare names no policy of this suite: 'zeor'; did you mean 'zero'?",
    },
    "adaptive": {
        "{max_seeds: 9, round: 99}": "nothing to decide; add compare\nadaptive.round: expected 9 seeds at most, got 99",
        "{}": "missing key 'max_seeds'",
    },
    "regression": {"{alfa: 1}": "unknown key 'alfa'"},
    "y" * 1_000: {"1": "unknown key 'yyy"},
    '"a\\nb\\e[31m"': {"1": "unknown key 'a\\nb\\x1b[31m'"},
    "nmae": {"s": "unknown key 'nmae'; did you mean 'name'?"},
}
NO_SUITES = {
    "": "expected a mapping with name, policies, tasks and seeds; found nothing",
    "[1, 2]": "found a list",
    "name: [": "not YAML",
    '"a\\nb": 1\n"a\\nb": 2': "duplicate key 'a\\nb'",
    "a" * 1_000_001: "expected a suite file of at most 1000000 bytes, this has 1000001",
    b"name: \xff": "expected UTF-8 text, found byte 0xff at offset 6",
}


def suite(**changes: str) -> str:
    """The text of a suite with these values, written as YAML."""
    return "".join(f"{key}: {value}\n" for key, value in (BASE | changes).items())


def _wrong_values():
    for fields, wrong in ((WHOLE, NOT_WHOLE), (NUMBERS, NOT_A_NUMBER), (NAMES, NOT_A_NAME)):
        for place, written in fields.items():
            key = place.partition(".")[0]
            yield place, {suite(**{key: written.format(value)}): says for value, says in wrong.items()}
    for key, values in OTHERS.items():
        yield key, {suite(**{key: value}): says for value, says in values.items()}


@pytest.mark.parametrize(
    "texts", [pytest.param(texts, id=key[:20]) for key, texts in (*_wrong_values(), ("no suite", NO_SUITES))]
)
def test_a_wrong_suite_is_refused_in_a_line_a_mistake(tmp_path, texts):
    def parse(text):
        (file := tmp_path / "bad.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
        load_suite(file, KNOWN)

    assert not_refused(parse, texts, SuiteError) == []
