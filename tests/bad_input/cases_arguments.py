"""Arguments of every verb that are of the wrong kind, out of range, empty, too long or beyond UTF-8."""

from itertools import product

from tests.bad_input.case import Case, table

WHOLE_NUMBERS = (
    ("run suite.yaml", "--seeds", "0", "10000001"),
    ("plan suite.yaml", "--seeds", "0", "10000001"),
    *((command, "--image-size", "15", "1025") for command in ("run suite.yaml", "plan suite.yaml")),
    *((command, "--replan-every", "0", "1000001") for command in ("run suite.yaml", "plan suite.yaml")),
    ("profile suite.yaml", "--seeds", "-1", "10000001"),
    ("verify runs/monday", "--sample", "-1", None),
    ("verify runs/monday", "--seed", "-1", None),
    ("history", "--limit", "0", None),
    ("export runs/monday --format lerobot-dataset", "--limit", "0", None),
    ("serve", "--port", "-1", "65536"),
    ("axes sheet noise --out x.png", "--seed", "-1", None),
    ("axes sheet noise --out x.png", "--image-size", "15", "1025"),
    ("policies check random --task null/Reach", "--seed", "-1", None),
    ("policies check random --task null/Reach", "--image-size", "0", "100000"),
    ("mergevla routing base", "--seeds", "0", "100001"),
    ("mergevla routing base", "--first-seed", "-1", None),
    ("bisect --good oracle --bad zero --task null/Reach", "--seeds", "0", "10001"),
    ("policies serve random", "--port", "-1", "65536"),
    ("policies serve random", "--batch", "0", "1025"),
    ("policies serve random", "--most-mib", "0", "1025"),
)
"""Command, option, and a value below and above its range."""
NUMBERS = (
    ("plan suite.yaml", "--width", "0", "100"),
    ("plan suite.yaml", "--detect", "0", "100"),
    ("plan suite.yaml --width 5", "--rate", "-1", "100.5"),
    ("plan suite.yaml --detect 5", "--discordance", "0", "101"),
    ("report runs/monday", "--video-mb", "-1", "1001"),
    ("compare runs/monday", "--alpha", "0", "0.5"),
    ("compare runs/monday", "--margin", "0", "1"),
    ("compare --gate runs/tuesday", "--alpha", "-0.05", "1"),
    ("compare --gate runs/tuesday", "--margin", "0", "1e3"),
    ("compare --all synthetic", "--alpha", "0", "0.5"),
    ("adapters check null", "--time-limit", "0", None),
    ("policies serve random", "--wait-ms", "-1", "1001"),
)
UNRANGED = (
    *(("policies demonstrate null/Reach --out new", name) for name in ("--episodes", "--first-seed", "--workers")),
    ("policies demonstrate null/Reach --out new", "--image-size"),
    *(("mergevla pretrain data/Reach --out new", name) for name in ("--steps", "--batch-size", "--seed", "--threads")),
    *(("mergevla finetune data/Reach --base base --out new", name) for name in ("--steps", "--rank", "--shift")),
    *(("mergevla merge experts --out new", name) for name in ("--rounds", "--keep-blocks")),
)
"""Whole numbers whose range depends on other things."""
CHOICES = (
    ("run suite.yaml --render-profile", "'standard'"),
    ("plan suite.yaml --render-profile", "'standard'"),
    ("report runs/monday --table", "'latex'"),
    ("report runs/monday --figures", "'svg'"),
    ("compare runs/monday runs/tuesday --format", "'text'"),
    ("compare runs/monday runs/tuesday --allow", "'suite'"),
    ("compare --gate runs/tuesday --format", "'text'"),
    ("compare --gate runs/tuesday --allow", "'suite'"),
    ("export runs/monday --format", "'run'"),
    ("export runs/monday --format lerobot-dataset --status", "'failure'"),
    ("log runs/monday --to", "'wandb'"),
    ("schedule print", "'systemd'"),
    ("policies demonstrate null/Reach --out new --render-profile", "'standard'"),
)
"""Command up to an option with a choice, and one of its values."""
TEXTS = (
    *("run {}", "run suite.yaml --policy {}", "run suite.yaml --task {}", "run suite.yaml --out {}"),
    *("run --policy random --task null/Reach --condition {}", "run suite.yaml --require {}"),
    *("run suite.yaml --store {}", "run suite.yaml --address {}", "run suite.yaml --history {}"),
    *("plan {}", "plan suite.yaml --out {}", "validate {}", "profile {}", "list --task {}", "report {}", "cite {}"),
    *("report runs/monday --condition {} --table latex", "replay {} --run runs/monday", "replay abc --run {}"),
    *("verify {}", "compare {}", "compare runs/monday {}", "compare runs/monday --out {}", "compare --gate {}"),
    *("compare --gate runs/tuesday {}", "history {}", "history --suite {}", "history p --out {}", "compare --all {}"),
    *("resume {}", "compare --accept {}", "forget {}", "export {}", "export runs/monday --out {}", "import {}"),
    *("import run.zip --out {}", "log {} --to mlflow", "serve --host {}", "serve --public-url {}"),
    *("schedule run {}", "schedule run n {}", "schedule list {}", "schedule serve {}", "schedule print cron {}"),
    *("axes show {}", "axes sheet {} --out x.png"),
    *("axes sheet noise --out {}", "env create {}", "env show {}", "env check {}", "env remove {}"),
    *("adapters check {}", "adapters check null --only {}", "adapters new {}", "adapters new mine --out {}"),
    *("bisect --good {} --bad zero --task null/Reach", "bisect --good oracle --bad {} --task null/Reach"),
    *("bisect --good oracle --bad zero --task {}", "bisect --good oracle --bad zero --task null/Reach {}"),
    *("bisect --good oracle --bad zero --task null/Reach --out {}",),
    *("policies new {}", "policies check {}", "policies check random --picture {}", "policies serve {}"),
    *("policies demonstrate {} --out new", "policies demonstrate null/Reach --out {}", "mergevla routing {}"),
    *("mergevla pretrain {} --out new", "mergevla pretrain data/Reach --out {}", "mergevla merge {} --out new"),
    *("mergevla finetune {} --base base --out new", "mergevla finetune data/Reach --base {} --out new"),
    *("search --policy {} --task null/Reach --budget 99", "search --policy random --task {} --budget 99"),
    *(f"search --policy random --task null/Reach --budget 99 {option} {{}}" for option in ("--axis", "--out")),
)
"""Every argument that is a name, a path, a pattern or an address."""
WRONG_TEXTS = {
    "{empty}": "expected a value, got an empty one",
    "{surrogate}": "expected text in UTF-8 without control characters, got U+DCFF",
    "{name300}": "expected names of at most 255 bytes and paths of 4095, got",
}
ONCE = (
    ("run {nul}", "got U+0000"),
    ("validate {nul}", "got U+0000"),
    ("run suite.yaml --out {newline}", "got U+000A"),
    ("history {escape}", "got U+001B"),
    ("report {blank}", "expected a value, got an empty one"),
    ("validate {long}", "expected at most 10000 characters, got 20000"),
    ("run suite.yaml --policy {long}", "expected at most 10000 characters, got 20000"),
    ("run suite.yaml --option seed={long}", "expected at most 10000 characters, got 20005"),
    ("report {path5000}", "expected names of at most 255 bytes and paths of 4095"),
    ("import {path5000}", "expected names of at most 255 bytes and paths of 4095"),
)
SETTINGS = (
    *(
        (f"{verb} suite.yaml --workers {wrong}", "--workers: expected auto, or a number from 1 to 10000")
        for verb in ("run", "plan")
        for wrong in ("0", "-1", "10001", "1.5", "many")
    ),
    ("run --policy random --task null/Reach --workers 0", "--workers: expected auto, or a number from 1 to 10000"),
)
MISUNDERSTOOD = (
    (
        "run why --policy oracle",
        "'oracle' is its gate or baseline already, name another policy: the suite needs a policy",
    ),
    (
        "plan why --policy oracle",
        "'oracle' is its gate or baseline already, name another policy: the suite needs a policy",
    ),
    ("run --policy random --task libero/spatial-0", "unknown task 'libero/spatial-0'; did you mean 'libero/spatial-0-"),
    ("run suiet", "no such file, and no shipped suite of that name; did you mean 'suite.yaml'?"),
    (
        "run runs/monday",
        "this is a run folder; to continue its run: robogauntlet run suites/synthetic.yaml --out runs/monday",
    ),
    ("run --policy oracle --task null/Reach --option image_size=224", "it is a key of suites: --image-size"),
    ("axes show lighting", "unknown axis 'lighting'; did you mean one of illuminance, light-direction, "),
    ("run suite.yaml --episodes 10", "No such option: --episodes (Possible options: --seeds)"),
    ("list --policies", "No such option: --policies (Possible options: --policy)"),
)
"""What is typed for something else, with what is meant."""
MISSING = (
    ("plan", "Error: Missing argument 'suite'."),
    ("validate", "Missing argument 'suites'"),
    ("replay", "expected an episode's id, or --policy, --task and --seed; got no id and no"),
    ("bisect --bad zero --task null/Reach", "Missing option '--good'"),
    ("bisect --good oracle --task null/Reach", "Missing option '--bad'"),
    ("bisect --good oracle --bad zero", "Missing option '--task'"),
    ("compare --gate --all", "expected one of --gate, --all, --accept, got --gate and --all"),
    ("compare --all synthetic --margin 0.1", "--margin: expected without --all"),
    ("compare runs/monday --imported", "--imported: expected with --all"),
    ("compare --all synthetic --format junit", "--format junit: expected text or json with --all"),
    ("compare --accept", "--accept: expected the run that becomes the baseline"),
    ("resume", "Missing argument 'run'"),
    ("forget", "Missing argument 'run'"),
    ("export", "Missing argument 'run'"),
    ("import", "Missing argument 'file'"),
    ("schedule run", "Missing argument 'name'"),
    ("axes sheet noise", "Missing option '--out'"),
    ("env create", "Missing argument 'name'"),
    ("adapters new", "Missing argument 'name'"),
    ("policies demonstrate null/Reach", "Missing option '--out'"),
    ("mergevla finetune data/Reach --out new", "Missing option '--base'"),
    ("mergevla merge --out new", "Missing argument 'EXPERTS...'"),
    ("policies serve", "Missing argument 'POLICY'"),
)
MISSPELT = (
    *("run --polcy", "plan --tsak", "validate --jsn", "list --tsk", "doctor --jso", "profile --sed", "report --stor"),
    *(
        "replay --vido",
        "verify --sampel",
        "resume --stor",
        "compare --alow",
        "bisect --god",
        "compare --gate --basline",
        "history --limt",
        "compare --all --alpa",
    ),
    *("compare --accept --histry", "forget --delte", "export --formt", "import --ot", "log --projct", "serve --prt"),
    *(
        "schedule run --histry",
        "schedule serve --public-ur",
        "axes sheet --sed",
        "env create --frsh",
        "env show --sute",
        "env check --sute",
    ),
    *("adapters check --tsk", "adapters new --ot", "policies new --ot", "policies check --pictur"),
    *(
        "policies demonstrate --episods",
        "mergevla pretrain --stps",
        "mergevla finetune --rnk",
        "mergevla merge --lamda",
    ),
    *("mergevla routing --kep", "policies serve --wait"),
)
UNKNOWN = (
    ("rnu suite.yaml", "No such command 'rnu'"),
    ("policies chek random", "No such command 'chek'. Did you mean 'check'?"),
    ("schedule rn n", "No such command 'rn'. Did you mean 'run'?"),
    ("axes lst", "No such command 'lst'"),
    ("env crate libero", "No such command 'crate'. Did you mean 'create'?"),
    ("adapters nwe mine", "No such command 'nwe'"),
    ("cite --nope", "No such option: --nope"),
    ("axes list --nope", "No such option: --nope"),
    ("axes show --nope", "No such option: --nope"),
    ("env list --nope", "No such option: --nope"),
    ("env remove --nope", "No such option: --nope"),
    ("adapters list --nope", "No such option: --nope"),
    ("schedule test-message --nope", "No such option: --nope"),
    ("schedule list --nope", "No such option: --nope"),
    ("schedule print cron --nope", "No such option: --nope"),
    ("doctor extra", "Got unexpected extra argument(s) (extra)"),
    ("report runs/monday runs/tuesday", "Got unexpected extra argument(s) (runs/tuesday)"),
    ("list extra", "'extra' is not one of 'simulators', 'tasks'"),
    ("plan suite.yaml suite.yaml", "Got unexpected extra argument(s) (suite.yaml)"),
    ("schedule serve schedules.yaml now", "Got unexpected extra argument(s) (now)"),
    ("run suite.yaml --seeds", "Option '--seeds' requires an argument"),
    ("run suite.yaml --retry-errors=yes", "Option '--retry-errors' does not take a value"),
)
LIST_OF_CHOICES = Case("log runs/monday", "Missing option '--to'\nwandb\nmlflow")


def _wrong_numbers(options, wrong):
    """Cases of each option with each wrong value, and with one below and one above its range."""
    for command, option, low, high in options:
        values = {
            **wrong,
            low: "expected a value greater than or equal to",
            high: "expected a value less than or equal to",
        }
        yield from (Case(f"{command} {option}={value}", says) for value, says in values.items() if value is not None)


CASES = [
    *_wrong_numbers(
        WHOLE_NUMBERS,
        {
            "1.5": "'1.5' is not a valid integer",
            "{arabic}": "'٣' is not a valid integer",
            "99999999999999999999": "expected at most 1000000000 in magnitude",
        },
    ),
    *_wrong_numbers(
        NUMBERS,
        {
            "much": "'much' is not a valid number",
            "nan": "'nan' is not a valid number",
            "1e300": "expected at most 1e+12 in magnitude",
        },
    ),
    *(Case(f"{command} {option}=two", "'two' is not a valid integer") for command, option in UNRANGED),
    *(Case(f"{command} nope", f"'nope' is not one of {first}") for command, first in CHOICES),
    *(Case(command.format(text), says) for command, (text, says) in product(TEXTS, WRONG_TEXTS.items())),
    *table(*SETTINGS, *MISUNDERSTOOD, *ONCE, *MISSING, *UNKNOWN),
    LIST_OF_CHOICES,
    *(Case(typed, "No such option") for typed in MISSPELT),
]
