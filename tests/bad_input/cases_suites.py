"""Suite files with a wrong value at each key, with text that is no suite, and with names that do not exist."""

from tests.bad_input.case import Case
from tests.bad_input.folder import SUITE

BASE = {"name": "s", "policies": "[random, zero]", "tasks": "[null/Reach]", "seeds": "{count: 2}"}
FREE = "name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 1}\n"
TEXT = "x" * 10_001
BOMB = "\n".join(["a0: &a0 [x, x]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10))])
NOT_WHOLE = {
    "many": "expected a valid integer, found text ('many')",
    '"3"': "expected a valid integer, found text ('3')",
    "2.5": "expected a valid integer, found a number (2.5)",
    "٣": "expected a valid integer, found text ('٣')",
    "true": "expected a valid integer, found true/false (True)",
    "-1": "expected a value greater than or equal to",
    "1000000000000000000": "expected a value less than or equal to",
    "[1]": "expected a valid integer, found a list",
}
NOT_A_NUMBER = {
    "much": "expected a valid number, found text ('much')",
    ".nan": "found nan",
    ".inf": "expected a value less than",
    "-1": "expected a value greater than",
    "1e300": "expected a value less than",
    "[1]": "expected a valid number, found a list",
}
NOT_A_NAME = {
    "a b": "expected letters, digits, '.', '_' or '-', starting with a letter or digit; found 'a b'",
    "-x": "expected letters, digits, '.', '_' or '-', starting with a letter or digit; found '-x'",
    "../s": "expected letters, digits",
    "é": "expected letters, digits",
    '""': "expected letters, digits",
    "5": "expected a valid string, found a whole number (5)",
    "y" * 81: "expected at most 80 characters, found text",
}
WHOLE = {  # key to how its value is written
    "horizon": "{}",
    "replan_every": "{}",
    "image_size": "{}",
    "max_attempts": "{}",
    "workers": "{{'null': {}}}",
    "seeds.count": "{{count: {}}}",
    "seeds.start": "{{count: 1, start: {}}}",
    "inference.batch": "{{batch: {}}}",
    "inference.replicas": "{{replicas: {}}}",
    "adaptive.round": "{{max_seeds: 9, round: {}}}",
    "adaptive.max_seeds": "{{max_seeds: {}}}",
}
NUMBERS = {
    "episode_time_limit_s": "{}",
    "error_tolerance": "{}",
    "resources.null.num_cpus": "{{'null': {{num_cpus: {}}}}}",
    "resources.null.num_gpus": "{{'null': {{num_gpus: {}}}}}",
    "resources.null.memory_gb": "{{'null': {{memory_gb: {}}}}}",
    "inference.wait_ms": "{{wait_ms: {}}}",
    "inference.num_gpus": "{{num_gpus: {}}}",
    "adaptive.alpha": "{{max_seeds: 9, alpha: {}}}",
    "regression.alpha": "{{alpha: {}}}",
    "regression.margin": "{{margin: {}}}",
}
NAMES = {"name": "{}", "policies.1.name": "[{{kind: random, name: {}}}]", "oracle_gate": "{}"}
OTHERS = {
    "description": {
        "[x]": "expected a valid string, found a list",
        TEXT: "expected at most 10000 characters, found text",
    },
    "needs": {
        "robot": "expected 'policy', found 'robot'",
        "policy": "'random': expected none but those of oracle_gate\n'zero': expected none but those of oracle_gate",
    },
    "policies": {
        "[]": "expected at least one entry, found an empty list",
        "random": "expected a list, found text ('random')",
        "[5]": "policies.1: expected a mapping, found a whole number (5)",
        "[[random]]": "policies.1: expected a mapping, found a list",
        "[{kind: 5}]": "policies.1.kind: expected a valid string, found a whole number (5)",
        "[{name: mine}]": "missing key 'kind'",
        f"[{'y' * 5_000}]": "name: expected at most 80 characters",
        "[randm]": "unknown policy 'randm'; did you mean 'random'?",
        "[random, random]": "duplicate policy 'random', already at entry 1",
        "[{kind: random, optoins: {}}]": "unknown key 'optoins'; did you mean 'options'?",
        "[{kind: random, options: {sead: 1}}]": "policy 'random' has no option 'sead'",
        f"[{{kind: random, options: {{{BOMB.replace(chr(10), ', ')}}}}}]": "its aliases stand for more",
        "[{kind: random, options: [1]}]": "expected a mapping, found a list",
        "[{kind: lerobot, options: {checkpoint: x, python: /bin/sh}}]": "a suite names no program",
        f"[{{kind: mergevla, options: {{checkpoint: {'y' * 300}}}}}]": "File name too long",
        "[{kind: openpi, options: {adress: x}}]": "policy 'openpi' has no option 'adress'; did you mean 'address'?",
    },
    "tasks": {
        "[]": "expected at least one entry, found an empty list",
        "null/Reach": "expected a list, found text",
        "[5]": "expected a valid string, found a whole number (5)",
        f"[null/{'y' * 9_000}]": "unknown task 'null/yyy",
        f"[{TEXT}]": "expected at most 10000 characters, found text",
        "[null/Reech]": "unknown task 'null/Reech'; did you mean 'null/Reach'?",
        "[nul/Reach]": "unknown simulator 'nul' in 'nul/Reach'",
        "[Reach]": "expected simulator/task, got 'Reach'",
        "['null/X*']": "unknown task 'null/X*'",
        "[null/Reach, null/Reach]": "duplicate task 'null/Reach'",
        '["null/\\u202eReach"]': "unknown task 'null/\\u202eReach'; did you mean",
        "['[!']": "expected simulator/task, got '[!'",
    },
    "conditions": {
        "[]": "expected at least one entry, found an empty list",
        "clean": "expected a list, found text ('clean')",
        "[noise]": "expected severities above 0 for 'noise'\nno clean condition",
        "[clean, nois]": "unknown condition 'nois'; did you mean 'noise'?",
        "[clean, clean]": "duplicate condition 'clean'",
        "[{axis: noise, severities: [1]}]": "no clean condition to compare the perturbed ones with; add clean",
        "[clean, {axis: noise, severities: []}]": "expected at least one entry, found an empty list",
        "[clean, {axis: noise, severities: 3}]": "expected a list, found a whole number (3)",
        "[clean, {axis: noise, severities: [6]}]": "expected a value less than or equal to 5, found 6",
        "[clean, {axis: noise, severity: [1]}]": "missing key 'severities'\nunknown key 'severity'; did you mean",
        f"[clean, {{axis: {'y' * 9_000}, severities: [1]}}]": "unknown condition 'yyy",
        "[{axis: clean, severities: [1]}]": "clean has severity 0 only\nno clean condition",
        "[clean, {axis: again, severities: [2]}]": "'again' has severity 1 at most, got 2",
        "[clean, {axis: noise, severities: [x]}]": "severities.1: expected a valid number, found text ('x')",
        "[clean, {axis: noise, severities: [true]}]": "expected a valid number, found true/false (True)",
        "[clean, {noise: 2, table: 6}]": "conditions.2: expected a severity above 0 and up to 5 for 'table', got 6",
        "[clean, {noise: 2, table: [1]}]": "expected a severity above 0 and up to 5 for 'table', got [1]",
        "[clean, {noise: 0, table: 1}]": "expected a severity above 0 and up to 5 for 'noise', got 0",
        "[clean, {noise: 2, tabel: 1}]": "unknown condition 'tabel'; did you mean 'table'?",
        "[clean, {axis: noise@-1+table@1, severities: [1]}]": "expected a combination such as camera-orbit@2",
        "[clean, {axis: noise@inf, severities: [1]}]": "expected a combination such as camera-orbit@2",
        "[clean, {axis: noise, severities: [1.001, 1.002]}]": "got 1.001\ngot 1.002",
        "[clean, noise@1.005]": "conditions.2: expected a severity in hundredths, such as 1, got 1.005",
        "[clean, {noise: 4.996, table: 2}]": "conditions.2: expected a severity in hundredths, such as 5, got 4.996",
        "[clean, 'noise:2']": "conditions.2: expected noise@2, got 'noise:2'",
        "[clean, noise=2]": "conditions.2: expected noise@2, got 'noise=2'",
        "[clean, noise@0.001]": "expected a severity from 0.01, got 0.001",
        "[clean, {noise: 0.001, table: 2}]": "expected a severity above 0 and up to 5 for 'noise', got 0.001",
        "[clean, noise@2+noise@3]": "conditions.2: expected each axis once, got 'noise' twice",
        "[clean, {camera-bump: 1, camera-orbit: 2}]": "'camera-bump' and 'camera-orbit' do not combine: both move",
        "[clean, {blind: 1, noise: 2}]": "the control 'blind' does not combine with others",
        "[clean, {distractors: 1.5, noise: 2}]": "'distractors' has whole severities only, got 1.5",
        "[clean, 5]": "conditions.2: expected a mapping, found a whole number (5)",
    },
    "design": {
        "noise": "design: expected a mapping, found text ('noise')",
        "{kind: sobol}": "missing key 'axes'",
        "{kind: lhs, axes: [noise]}": "expected 'one-at-a-time', 'grid', 'latin-hypercube' or 'sobol', found 'lhs'",
        "{kind: grid, axes: []}": "design.axes: expected at least one entry, found an empty list",
        "{kind: grid, axes: [noise, noise]}": "design: expected each axis once, got 'noise' twice",
        "{kind: grid, axes: [nose]}": "unknown axis 'nose'; did you mean 'noise'?",
        "{kind: grid, axes: [blind]}": "unknown axis 'blind'",
        "{kind: grid, axes: [noise], severities: [6]}": "expected a value less than or equal to 5, found 6",
        "{kind: grid, axes: [noise], severities: [0]}": "expected a value greater than 0, found 0",
        "{kind: grid, axes: [noise], points: 8}": "design: expected no 'points' for kind grid, got 8",
        "{kind: sobol, axes: [noise]}": "expected points of a sobol design, such as points: 64, got none",
        "{kind: sobol, axes: [noise], points: 6}": "expected a power of two as points of a sobol design, got 6",
        "{kind: sobol, axes: [noise], points: 8192}": "expected 10000 conditions at most, got a design of 24576",
        "{kind: sobol, axes: [noise, action-delay], points: 8, max_severity: 9}": "less than or equal to 5, found 9",
        "{kind: grid, axes: [distractors, noise], severities: [1.5]}": "'distractors' has whole severities only",
        "{kind: grid, axes: [noise], severities: [1, 1]}": "design: expected each severity once, got 1 twice",
        "{kind: grid, axes: [noise], severities: [1.005]}": "in hundredths, such as 1, got 1.005",
        "{kind: sobol, axes: [noise], points: 4, max_severity: 4.996}": "in hundredths, such as 5, got 4.996",
        "{kind: grid, axes: [noise], severities: [0.001]}": "expected a severity from 0.01, got 0.001",
        "{kind: sobol, axes: [distractors], points: 4, max_severity: 0.5}": "max_severity from 1",
        "{kind: grid, axes: [a+b, noise]}": "expected the name of an axis, got 'a+b'",
        "{kind: grid, axes: [camera-bump, camera-orbit]}": "do not combine: both move the third-person camera",
        "{kind: latin-hypercube, axes: [table, noise], points: 4}": "axis 'table' is unsupported in null/Reach",
    },
    "seeds": {
        "10": "expected a mapping, found a whole number (10)",
        "{}": "missing key 'count'",
        "{count: 1:30}": "expected a decimal number, or text in quotes; found 1:30, which YAML converts",
        "{count: 010}": "expected a decimal number, or text in quotes; found 010, which YAML converts",
        "{cuont: 1}": "missing key 'count'\nunknown key 'cuont'; did you mean 'count'?",
        "[1, 2]": "expected a mapping, found a list",
    },
    "cameras": {
        "[]": "expected at least one entry, found an empty list",
        "[wirst]": "unknown camera 'wirst'; did you mean 'wrist'?",
        "[wrist, wrist]": "duplicate camera 'wrist'",
        "wrist": "expected a list, found text ('wrist')",
    },
    "render_profile": {"slow": "expected 'standard', 'fast' or 'fast-2', found 'slow'", "5": "'fast-2', found 5"},
    "protocol": {
        "openvla": "expected openvla with tasks of LIBERO only, got null/Reach; leave it out",
        "openpi": "expected 'robogauntlet' or 'openvla', found 'openpi'",
    },
    "success": {
        "twice": "expected 'held' or 'once', found 'twice'",
        "5": "expected 'held' or 'once', found 5",
    },
    "workers": {
        "many": "expected 'auto', found 'many'",
        f"{{{'y' * 1_000}: 2}}": "unknown simulator 'yyy",
        "{nul: 2}": "unknown simulator 'nul'",
        "[2]": "workers: expected a valid integer, found a list",
        "0": "expected a value greater than or equal to 1, found 0",
        "999999999": "expected a value less than or equal to 10000, found 999999999",
    },
    "resources": {
        "{'null': {num_cpu: 1}}": "unknown key 'num_cpu'",
        "{nul: {num_cpus: 1}}": "unknown simulator 'nul'",
        "{'null': 5}": "found a whole number (5)",
        "[]": "expected a mapping, found a list",
        "{'null': {num_cpus: 1, memory: 2}}": "unknown key 'memory'; did you mean 'memory_gb'?",
    },
    "environments": {
        "{'null': {interpreter: /bin/sh}}": "a suite names no program",
        "{'null': {interpreter: python}}": "expected the full path of a Python interpreter",
        "{'null': {python: '3.99'}}": 'expected a version such as "3.11", in quotes',
        "{'null': {requirements: [a b c]}}": "expected a requirement of pip, such as robosuite==1.4.0, and no",
        "{'null': {without_dependencies: ['==1']}}": "expected a requirement of pip",
        "{'null': {python: 3.1}}": 'expected a version such as "3.11", in quotes',
        "{'null': {requirements: [--index-url=http://x]}}": "expected a requirement of pip",
        "{'null': {installer: conda}}": "expected 'pip' or 'uv', found 'conda'",
        "{'null': {installer: uv}}": "expected inherit: false with uv",
        "{nul: {python: '3.11'}}": "unknown simulator 'nul'",
    },
    "inference": {
        "cloud": "expected 'worker', 'served' or 'auto', found 'cloud'",
        "{plaec: worker}": "unknown key 'plaec'; did you mean 'place'?",
        "5": "found a whole number (5)",
    },
    "episode_time_limit_s": {"1.0e-300": "expected a value greater than or equal to 1, found 1e-300"},
    "oracle_gate": {
        "random": "oracle_gate: expected an oracle, 'random' is a baseline without skill",
        "zero": "expected an oracle, 'zero' is a baseline without skill",
    },
    "no_skill_baselines": {
        "[random, random]": "duplicate policy 'random'",
        "[random, zero]": "no_skill_baselines: expected a policy beside the baselines, got none",
        "[oracle]": "no_skill_baselines names no policy of this suite: 'oracle'",
        "5": "expected a list, found a whole number (5)",
    },
    "merging": {
        "{}": "missing key 'expert'\nmissing key 'oracle_routed'\nmissing key 'routed'",
        "[random]": "expected a mapping, found a list",
        "{expert: a, oracle_routed: b, routed: [c]}": "no policy of this suite: 'a'\nsuite: 'b'\nsuite: 'c'",
    },
    "compare": {
        "{baseline: random}": "missing key 'others'",
        "{baseline: random, others: []}": "expected at least one entry, found an empty list",
        "{baseline: random, others: [zero], margin: 2}": "compare.margin: expected a value less than 1, found 2",
        "{baseline: random, others: [zero], margin: 0}": "compare.margin: expected a value greater than 0, found 0",
        "{baseline: random, others: [zero], margin: much}": "compare.margin: expected a valid number, found text",
        "{baseline: random, others: [random]}": "compare names policy 'random' twice; each side is another policy",
        "{baseline: random, others: [zeor]}": "compare names no policy of this suite: 'zeor'; did you mean 'zero'?",
    },
    "adaptive": {
        "{max_seeds: 9, round: 99}": "nothing to decide; add compare\nadaptive.round: expected 9 seeds at most, got 99",
        "{max_seeds: 9}": "nothing to decide; add compare",
        "{}": "missing key 'max_seeds'",
    },
    "regression": {"{alfa: 1}": "unknown key 'alfa'", "5": "found a whole number (5)"},
    "y" * 1_000: {"1": "unknown key 'yyy"},
    '"a\\nb\\e[31m"': {"1": "unknown key 'a\\nb\\x1b[31m'"},
    "nmae": {"s": "unknown key 'nmae'; did you mean 'name'?"},
    "seads": {"{count: 1}": "unknown key 'seads'; did you mean 'seeds'?"},
    "horizont": {"5": "unknown key 'horizont'; did you mean 'horizon'?"},
}
NO_SUITES = {
    "": "expected a mapping with name, policies, tasks and seeds; found nothing",
    "5": "found a whole number (5)",
    "- a\n- b": "found a list",
    "hello": "found text ('hello')",
    "name: [": "not YAML",
    "name: s\n\tpolicies: x": "not YAML",
    "name: s\nname: t": "duplicate key 'name'",
    '"a\\nb": 1\n"a\\nb": 2': "duplicate key 'a\\nb'",
    f"{'y' * 9_000}: 1\n{'y' * 9_000}: 2": "not YAML",
    "a: &a [*a]": "an alias that contains itself",
    BOMB: "expected at most 100000 values, its aliases stand for more",
    "[" * 200: "expected at most 50 lists and mappings inside each other",
    "{a: " * 200: "expected at most 50 lists and mappings inside each other",
    "--- 1\n--- 2": "not YAML: but found another document",
    "name: !!python/object/apply:os.system [id]": "found the tag",
    "name: !!binary aGk=": "found the tag",
    "name: 2026-01-01": "expected plain YAML, found a date",
    "name: *nothing": "not YAML",
    "x: " + "9" * 101: "expected a number of at most 100 characters, found 101",
    'name: "\\ud800"': "found the character U+D800",
    'name: "\\0"': "found the character U+0000",
    "? [a, b]\n: c": "found unhashable key",
    "a" * 1_000_001: "expected a suite file of at most 1000000 bytes, this has 1000001",
    "%YAML 9.9\n---\na: b": "not YAML",
}
BYTES = {
    b"name: s\0": "not YAML: character U+0000",
    b"name: \xff": "expected UTF-8 text, found byte 0xff at offset 6",
    b"\x1f\x8b\x08\x00": "expected UTF-8 text, found byte 0x8b",
    b"name: \x1b[31m": "not YAML: character U+001B",
    "name: s".encode("utf-16"): "expected UTF-8 text, found byte 0xff",
}


def suite(**changes: str) -> str:
    """The text of a suite with these values, written as YAML."""
    return "".join(f"{key}: {value}\n" for key, value in (BASE | changes).items())


def _wrong_values():
    """Cases of a key with a wrong value."""
    for fields, wrong in ((WHOLE, NOT_WHOLE), (NUMBERS, NOT_A_NUMBER), (NAMES, NOT_A_NAME)):
        for place, written in fields.items():
            for value, says in wrong.items():
                yield place.partition(".")[0], written.format(value), says
    for key, values in OTHERS.items():
        yield from ((key, value, says) for value, says in values.items())


ELSEWHERE = [
    Case(
        "validate bad.yaml",
        "no_skill_baselines: 'oracle' is the oracle gate; expected another policy",
        {"bad.yaml": suite(policies="[oracle, random]", oracle_gate="oracle", no_skill_baselines="[oracle]")},
    ),
    Case("validate nowhere.yaml", "nowhere.yaml: no such file"),
    Case("validate suit.yaml", "no such file; did you mean suite.yaml?"),
    Case("validate smok", "no such file, and no shipped suite of that name; did you mean 'smoke'?"),
    Case("validate notes", "expected a suite file, this is a directory"),
    Case("validate run.zip", "expected UTF-8 text"),
    Case("validate text/suite.yaml", "cannot be read: Not a directory"),
    Case("validate bad.yaml other.yaml", "bad.yaml\nother.yaml", {"bad.yaml": "5", "other.yaml": "[]"}),
    Case("plan bad.yaml", "unknown policy", {"bad.yaml": suite(policies="[oracel]")}),
    Case("plan suite.yaml --policy 'z*'", "no policy 'z*'"),
    Case("plan suite.yaml --task null/Raise", "the suite has no task 'null/Raise'"),
    Case("plan suite.yaml --seeds 3", "expected 1 to 2 seeds, got 3"),
    Case("plan suite.yaml --option seed", "expected NAME=VALUE, got 'seed'"),
    Case("plan suite.yaml --out text", "text: expected a run folder, this is a file"),
    Case("plan suite.yaml --out runs/monday", "it holds a run of suite 'synthetic', not 's'"),
    Case("plan suite.yaml --rate 80", "--rate: expected with --width, whose interval it is for"),
    Case("plan suite.yaml --detect 5 --rate 80", "--rate: expected with --width, whose interval it is for"),
    Case("plan suite.yaml --discordance 20", "--discordance: expected with --detect, whose pairs it is about"),
    Case(
        "plan suite.yaml --width 5 --discordance 20", "--discordance: expected with --detect, whose pairs it is about"
    ),
    Case(
        "plan suite.yaml --detect 10 --discordance 5", "--discordance 5: expected at least the difference to detect, 10"
    ),
    Case("plan suite.yaml --detect 10", "--detect: expected two policies or more to compare, suite 's' has random"),
    Case(
        "plan suite.yaml --width 5 --out nope", "nope: expected a run of the suite, whose episodes say what to assume"
    ),
    Case("plan free.yaml", "beside needs: policy\nbeside needs: policy", {"free.yaml": suite(needs="policy")}),
    Case("plan free.yaml", "free.yaml: the suite needs a policy; add --policy with", {"free.yaml": FREE}),
    Case("run free.yaml --out new", "free.yaml: the suite needs a policy; add --policy with", {"free.yaml": FREE}),
    Case(
        "profile bad.yaml",
        "bad.yaml:3: unknown task 'null/Raech'; did you mean",
        {"bad.yaml": suite(tasks="[null/Raech]")},
    ),
    Case("profile text", "expected a mapping with name, policies, tasks and seeds; found text ('hello')"),
    Case("profile empty", "expected a mapping with name, policies, tasks and seeds; found nothing"),
    Case("profile notes", "notes: expected a suite file, this is a directory"),
    Case("profile runs/monday/episodes.sqlite", "expected UTF-8 text"),
    Case("profile nowhere.yaml", "nowhere.yaml: no such file"),
    Case("run bad.yaml --out new", "missing key 'seeds'", {"bad.yaml": SUITE.partition("seeds")[0]}),
    Case("env show null --suite bad.yaml", "not YAML", {"bad.yaml": "name: ["}),
    Case("env create null --suite nowhere", "no such file, and no shipped suite of that name"),
    Case(
        "schedule list",
        "horizon: expected a value greater than or equal to 1, found 0",
        {"bad.yaml": suite(horizon="0"), "schedules.yaml": "n: {suite: bad.yaml, cron: '@daily'}"},
    ),
    Case(
        "policies demonstrate bad.yaml --out new",
        "unknown camera 'eye'; known: third_person, wrist",
        {"bad.yaml": suite(cameras="[eye]")},
    ),
]
CASES = [
    *(Case("validate bad.yaml", says, {"bad.yaml": suite(**{key: value})}) for key, value, says in _wrong_values()),
    *(Case("validate bad.yaml", says, {"bad.yaml": text}) for text, says in (NO_SUITES | BYTES).items()),
    *ELSEWHERE,
]
