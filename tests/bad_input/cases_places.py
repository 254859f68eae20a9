"""Schedules, axes, environments, adapters, and the user's configuration file."""

from tests.bad_input.case import SECRET, Case, table

CRONS = {
    "hourly": "expected five fields",
    "'* * * *'": "expected five fields",
    "'* * * * * *'": "expected five fields",
    "'60 * * * *'": "Bad minute; expected five fields",
    "'-1 * * * *'": "Bad minute; expected five fields",
    "'* 24 * * *'": "Bad hour; expected five fields",
    "'* * 0 * *'": "Bad day-of-month; expected five fields",
    "'* * 32 * *'": "Bad day-of-month; expected five fields",
    "'* * * 13 *'": "Bad month; expected five fields",
    "'* * * foo *'": "Bad month; expected five fields",
    "'* * * * 8'": "Bad day-of-week; expected five fields",
    "'* * * * noday'": "Bad day-of-week; expected five fields",
    "'*/0 * * * *'": "Bad minute; expected five fields",
    "'*/x * * * *'": "Bad minute; expected five fields",
    "'1-x * * * *'": "Bad minute; expected five fields",
    "'1,,2 * * * *'": "Bad minute; expected five fields",
    "'9-5 * * * *'": "Bad minute; expected five fields",
    "'99999999999999999999 * * * *'": "Bad minute; expected five fields",
    "'٣ * * * *'": "expected five fields",
    "'0 0 31 2 *'": "expected five fields",
    "'0 0 30 feb *'": "expected five fields",
    "'@dayly'": "expected five fields",
    "'@reboot'": "expected five fields",
    "'@daily x'": "expected five fields",
    "'$(id) * * * *'": "Bad minute; expected five fields",
    "'% * * * *'": "Bad minute; expected five fields",
}
FILES = {
    **{f"n: {{suite: smoke, cron: {cron}}}": says for cron, says in CRONS.items()},
    **{
        f"n: {{suite: smoke, cron: '@daily', timezone: {zone}}}": "expected one of the IANA list such as Europe/Berlin"
        for zone in ("Mars", "europe/berlin", "../etc/passwd", "/etc/localtime", "UTC+25")
    },
    **{
        f"{name}: {{suite: smoke, cron: '@daily'}}": "expected letters, digits, '-' and '_', at most 63"
        for name in ("'a b'", "../x", "a/b", "é", "n" * 64, "_x")
    },
    "n: {suite: smok, cron: '@daily'}": "did you mean 'smoke'?",
    "n: {suite: nowhere.yaml, cron: '@daily'}": "nowhere.yaml: no such file",
    "n: {suite: notes, cron: '@daily'}": "notes: expected a suite file, this is a directory",
    "n: {suite: smoke, cron: '@daily', keep: 0}": "n.keep: Input should be greater than or equal to 1",
    "n: {suite: smoke, cron: '@daily', arguments: x}": "n.arguments: Input should be a valid list",
    "n: {suite: smoke, cron: '@daily', gate: 1}": "n.gate: Input should be a valid boolean",
    "n: {suite: smoke}": "n.cron: Field required",
    "": "expected a mapping, such as",
    "{}": "expected a schedule, such as",
    "[": "not YAML",
}
SCHEDULES = [
    *(Case("schedule list", says, {"schedules.yaml": text}) for text, says in FILES.items()),
    Case("schedule run m", "no schedule 'm'", {"schedules.yaml": "nightly: {suite: smoke, cron: '@daily'}"}),
    *table(
        ("schedule run nightly", "schedules.yaml: no such file"),
        ("schedule serve nowhere.yaml", "nowhere.yaml: no such file"),
        ("schedule print cron notes", "notes: expected a file of schedules, this is a directory"),
    ),
]
NOTIFIERS = [
    Case("schedule test-message", says, variables=variables)
    for variables, says in (
        ({}, "no recipient: set ROBOGAUNTLET_WEBHOOK_URL, or the variables for e-mail (docs/operating.md)"),
        ({"ROBOGAUNTLET_WEBHOOK_URL": "nonsense"}, "ROBOGAUNTLET_WEBHOOK_URL"),
        ({"ROBOGAUNTLET_WEBHOOK_URL": f"ftp://u:{SECRET}@x"}, "ROBOGAUNTLET_WEBHOOK_URL"),
        (
            {"ROBOGAUNTLET_SMTP_HOST": "h"},
            "MAIL_FROM: not set, but e-mail needs it\nMAIL_TO: not set, but e-mail needs it",
        ),
        ({"ROBOGAUNTLET_SMTP_URL": f"smtp://u:{SECRET}@h:port"}, "ROBOGAUNTLET"),
    )
]
CONFIGURATIONS = {
    "5": "expected a mapping with environments, defaults; found a whole number (5)",
    "[]": "expected a mapping with environments, defaults; found a list",
    "a: [": "not YAML",
    "a: &a [*a]": "an alias that contains itself",
    "default: {}": "unknown key 'default'; did you mean 'defaults'?",
    "defaults: 5": "defaults: expected a mapping, found a whole number (5)",
    "defaults: {rnu: {}}": "defaults: no verb 'rnu'; did you mean 'run'?",
    "defaults: {validate: 5}": "defaults.validate: expected a mapping, found a whole number (5)",
    "defaults: {validate: {jsn: true}}": "defaults: 'validate' has no 'jsn'; did you mean 'json'?",
    "defaults: {validate: {json: maybe}}": "'--json': expected a valid boolean, got 'maybe'",
    "environments: 5": "environments: expected a mapping, found a whole number (5)",
    "environments: {nul: {python: '3.11'}}": "unknown simulator 'nul'",
    "environments: {'null': 5}": "environments.null: expected a mapping, found a whole number (5)",
    "environments: {'null': {interpreter: python}}": "expected the full path of a Python interpreter",
    "environments: {'null': {interpreter: /bin/sh, inherit: true}}": "expected an interpreter alone",
    "environments: {'null': {pyton: '3.11'}}": "unknown key 'pyton'; did you mean 'python'?",
    "environments: {'null': {python: '3.1.2'}}": 'expected a version such as "3.11", in quotes',
    "environments: {'null': {requirements: robosuite}}": "expected a list, found text ('robosuite')",
    "environments: {'null': {requirements: ['-e .']}}": "expected a requirement of pip",
    "environments: {'null': {requirements: ['']}}": "expected a requirement of pip",
    "environments: {'null': {inherit: maybe}}": "inherit",
    "x" * 1_000_001: "expected a configuration file of at most 1000000 bytes",
    b"\xff": "expected UTF-8 text, found byte 0xff",
    b"a: \0": "not YAML: character U+0000",
}
CONFIG = {"ROBOGAUNTLET_CONFIG": "config.yaml"}
DEFAULTS = {
    ("history", "limit: 0"): "expected a value greater than or equal to 1, got 0",
    ("history", "limit: many"): "limit",
    ("history", "limit: 1.5"): "limit",
    ("history", "limit: [1]"): "expected a valid integer, got '[1]'",
    ("history", "limit: 99999999999999999999"): "limit",
    ("history", "suite: ''"): "suite",
    ("history", 'suite: "a\\nb"'): "suite",
    ("history", "history: nonsense"): "not a store URL: nonsense",
    ("report", "table: xls"): "table",
    ("report", "video-mb: .nan"): "video",
    ("compare --all x", "alpha: 2"): "alpha",
    ("schedule run", "run: {histry: x}"): "'schedule run' has no 'histry'; did you mean 'history'?",
    ("schedule list", "lst: {}"): "'schedule' has no 'lst'; did you mean 'list'?",
    ("schedule list", "list: 5"): "expected options of 'schedule list', got 5",
}
OTHERS = table(
    ("list --task nul/*", "no task matches 'nul/*'"),
    ("list --task '['", "no task matches '['"),
    ("axes show nois", "unknown axis 'nois'; did you mean 'noise'?"),
    ("axes sheet nois --out x.png", "unknown axis 'nois'; did you mean 'noise'?"),
    ("axes sheet noise --out x.jpg", "expected a file that ends in .png for --out, got 'x.jpg'"),
    ("axes sheet noise --out nowhere/x.png", "nowhere/x.png: expected a file in an existing folder"),
    ("axes sheet noise --out text/x.png", "text/x.png: expected a file in an existing folder"),
    ("axes sheet noise --out x.png --task null/Reech", "unknown task 'null/Reech'; did you mean 'null/Reach'?"),
    ("axes sheet noise --out x.png --task Reach", "unknown simulator 'Reach'; known: gymnasium"),
    ("axes sheet noise --out x.png --task nul/Reach", "unknown simulator 'nul'; known: gymnasium"),
    ("env create nul", "unknown simulator 'nul'"),
    ("env create liberro", "unknown simulator 'liberro'; did you mean 'libero'?"),
    ("env show null", "null: runs in the running environment"),
    ("env check null", "null: runs in the running environment"),
    ("env create null", "null: runs in the running environment"),
    ("env remove nope", "nope: no environment of that name; see: robogauntlet env list"),
    ("env remove ../x", "../x: no environment of that name"),
    ("env remove '*'", "*: no environment of that name"),
    ("env show libero --suite text", "expected a mapping with name, policies, tasks and seeds; found text ('hello')"),
    ("adapters check nul", "unknown simulator 'nul'"),
    ("adapters check null --task Reech", "unknown task 'null/Reech'; did you mean 'null/Reach'?"),
    ("adapters check null --task pybullet/Reach", "unknown task 'pybullet/Reach'"),
    ("adapters check null --only sedes", "unknown check 'sedes'; did you mean 'seeds'?"),
    ("adapters check libero", "environment libero does not exist; create it"),
    *(
        (f"adapters new '{name}'", "expected a name of up to 40 small letters, digits and single dashes")
        for name in ("MySim", "my sim", "my_sim", "x-", "1x", "../up", "é")
    ),
    ("adapters new maniskill", "the simulator 'maniskill' exists already; choose another name"),
    ("adapters new " + "a" * 41, "'" + "a" * 41),
    ("adapters new mine --out notes", "notes exists; give another folder with --out"),
    ("adapters new mine --out text", "text exists; give another folder with --out"),
    ("adapters new mine --out text/x", "text/x cannot be created: Not a directory"),
)
CASES = [
    *SCHEDULES,
    *NOTIFIERS,
    *OTHERS,
    *(Case("validate suite.yaml", says, {"config.yaml": text}, CONFIG) for text, says in CONFIGURATIONS.items()),
    *(
        Case(typed, says, {"config.yaml": f"defaults: {{{typed.split()[0]}: {{{given}}}}}"}, CONFIG)
        for (typed, given), says in DEFAULTS.items()
    ),
    Case(
        "validate suite.yaml",
        "nowhere/config.yaml: no such file",
        variables={"ROBOGAUNTLET_CONFIG": "nowhere/config.yaml"},
    ),
    Case(
        "validate suite.yaml",
        "notes: expected a configuration file, this is a directory",
        variables={"ROBOGAUNTLET_CONFIG": "notes"},
    ),
]
