"""Policies that do not exist or cannot be had, checkpoints and datasets that are none, and options of training."""

import struct
from functools import partial

from tests.bad_input.case import SECRET, Case, table
from tests.bad_input.forged import document_with

HUGE = 10**18
CARD = "experts/null-Reach/card.json"
WEIGHTS = "experts/null-Reach/model.safetensors"
INFO = "data/Reach/meta/info.json"
TASKS = "data/Reach/meta/tasks.parquet"
FRAMES = "data/Reach/data/chunk-000/file-000.parquet"
MERGE = "policies merge experts/null-Reach experts/null-Slow --out new"
TRAIN = "policies finetune data/Reach --base base --out new --steps 1 --batch-size 2 --rank 2"
PLAY = "run --policy {} --task null/Reach --seeds 1 --out new"
REFERENCES = {
    "randm": "got 'randm'; did you mean 'random'?",
    "nowhere/checkpoint": "expected openpi://HOST:PORT, python:MODULE:NAME, lerobot:FOLDER, zoo:NAME",
    "text": "expected openpi://HOST:PORT",
    "notes": "expected openpi://HOST:PORT",
    "zoo:nothing": "expected the name of a shipped checkpoint after 'zoo:', got",
    "zoo:../base": "expected the name of a shipped checkpoint after 'zoo:', got",
    "zoo:": "expected the name of a shipped checkpoint after 'zoo:', got",
    "python:": "got 'python:'; did you mean 'python'?",
    "python:nomodule:Policy": "expected a module 'nomodule' in",
    "python:json": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got 'json'",
    "python:json:Nothing": "json has no 'Nothing'",
    "python:json:decoder:x": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got 'json:decoder:x'",
    "python:../x:Policy": "expected python:MODULE:NAME, or option callable: MODULE:NAME, got '../x:Policy'",
    "python:broken:Policy": "importing 'broken' raised SyntaxError: invalid syntax (broken.py, line 1)",
    "python:ends:Policy": "importing 'ends' raised RuntimeError: at import",
    "python:number:Policy": "expected a class or a function, got int",
    "openpi:": "got 'openpi:'; did you mean 'openpi'?",
    "openpi://": "address: expected ws://HOST:PORT, got",
    "openpi://host:port": "address: expected ws://HOST:PORT, got",
    "openpi://host:99999": "address: expected ws://HOST:PORT, got",
    "openpi:http://host:1": "address: expected ws://HOST:PORT, got",
    f"openpi://u:{SECRET}@host:1": "address: expected ws://HOST:PORT, got",
    "openpi://127.0.0.1:1": "policy server ws://127.0.0.1:1",
    "lerobot:nowhere": "expected a folder or an id on the hub, got 'nowhere'",
    "experts": "policy 'experts' does not fit: the policy was made for 16 px images, the suite renders 96 px",
    "base": "policy 'base' does not fit: the policy was made for 16 px images, the suite renders 96 px",
}
SEARCH = "bisect --good {} --bad {} --task null/Reach --out new {}"
SEARCHED = {
    ("oracle", "oracle", ""): "expected each policy once, got 'oracle' twice",
    ("oracle", "zero", "random zero"): "expected each policy once, got 'zero' twice",
    ("oracle", "zero", "random random"): "expected each policy once, got 'random' twice",
    ("oracle", "zero", "randm"): "got 'randm'; did you mean 'random'?",
    ("oracle", "zero", "python:nomodule:Policy"): "expected a module 'nomodule' in",
    ("base", "zero", ""): "policy 'base' does not fit: the policy was made for 16 px images, the suite renders 96 px",
    ("orcale", "zero", ""): "got 'orcale'; did you mean 'oracle'?",
    ("oracle", "nowhere/checkpoint", ""): "expected openpi://HOST:PORT, python:MODULE:NAME",
    ("oracle", "zoo:nothing", ""): "expected the name of a shipped checkpoint after 'zoo:', got",
    ("oracle", "replay", ""): "policy 'replay' cannot act in 'null/Reach'",
    ("oracle", "zero", "--task null/Rech"): "unknown task 'null/Rech'; did you mean 'null/Reach'?",
    ("oracle", "zero", "--task 'null/Re*'"): "duplicate task 'null/Reach'",
    ("oracle", "zero", "--task nul/Reach"): "unknown simulator 'nul'",
    ("oracle", "zero", "--option sead=1"): "policy 'oracle', 'zero' has no option 'sead'",
    ("oracle", "zero", "--out text"): "text",
    ("oracle", "zero", "--out runs/monday"): "runs/monday",
    ("oracle", "zero", "--option seed"): "--option: expected NAME=VALUE, got 'seed'",
}
"""The ends and what is between them, or further options, and what the answer says."""
MODULES = {
    "broken.py": "def Policy(:\n",
    "ends.py": "raise RuntimeError('at import')\n",
    "number.py": "Policy = 5\n",
}
OPTIONS = {
    "random --option seed": "--option: expected NAME=VALUE, got 'seed'",
    "random --option =1": "--option: expected NAME=VALUE, got '=1'",
    "random --option sead=1": "policy 'random' has no option 'sead'",
    "random --option 'a=['": "--option a: not YAML",
    "random --option 'a=!!python/name:os.system'": "--option a: expected plain YAML, found the object tag",
    "random --option a=2026-01-01": "--option a: expected plain YAML, found a date",
    "replay --option file=nowhere": "policy 'replay' has no option 'file'",
    "python:json:loads --option n=1": "policy 'python' has no option 'n'",
    "openpi://127.0.0.1:1 --option token_variable=WANDB_API_KEY": "token_variable: expected ROBOGAUNTLET_POLICY",
    "openpi://127.0.0.1:1 --option timeout_s=-1": "timeout_s: expected greater than 0, got -1",
    "openpi://127.0.0.1:1 --option timeout_s=.nan": "timeout_s: expected a finite number, got nan",
    "openpi://127.0.0.1:1 --option convention=nope": "convention: expected 'robogauntlet' or 'libero', got 'nope'",
}
CARDS = [
    *(("format", value, "expected metadata of format 1, got") for value in (2, "1", None)),
    ("kind", "merged", "expected a checkpoint of one network, got a merged checkpoint"),
    ("kind", ["x"], "expected a checkpoint of one network"),
    *(("architecture", value, "architecture") for value in (5, None, {}, [], {"name": 5})),
    *(("architecture:image_size", value, "image_size") for value in (0, -1, HUGE, "big", 1.5)),
    *(("architecture:chunk_length", value, "chunk_length") for value in (0, HUGE, None)),
    ("architecture:cameras", "wrist", "cameras"),
    ("architecture:language:width", HUGE, "width"),
    ("architecture:language:layers", 10**9, "layers"),
    *(("statistics", value, "statistics") for value in (5, [], {"null/Reach": 5}, {"null/Reach": {}})),
    ("statistics:null/Reach:action:q01", [1], "q01"),
    ("statistics:null/Reach:action:q01", ["a"] * 7, "q01"),
    ("statistics:null/Reach:action:q99", [float("nan")] * 7, "q99"),
    *(("action_steps", value, "action_steps") for value in ("all", 1.5)),
    *(("action_steps", value, "expected 1 to 8 action steps, the length of a chunk, got") for value in (0, -1, HUGE)),
    *(("lora", value, "lora") for value in (5, {"rnk": 2})),
    *(("lora", {"rank": value}, "expected a LoRA rank of 1") for value in (0, HUGE)),
    *(("base", value, "base") for value in (5, "../../nowhere", "/dev/null", "a\0b")),
    *(("tensor_hash", value, "hash") for value in ("0" * 64, 5, None)),
    ("base", "../../../../../../etc", "expected card.json in"),
    ("base", "x" * 300, "expected its base at 'xxx"),
    *(("architecture:language:heads", value, "heads: expected greater than or equal to 1") for value in (0, -1)),
    ("base_hash", "0" * 64, "hash"),
    ("nope", 1, "nope"),
    ("metrics", {"loss": "low"}, "metrics"),
]
CARD_TEXTS = ("", "{", "[]", "null", "5", "[" * 100_000, b"\xff")
HEADERS = {
    "a header of 2^62 bytes": struct.pack("<Q", 2**62) + b"{}",
    "a header beyond the file": struct.pack("<Q", 1000) + b"{}",
    "no header": b"",
    "seven bytes": b"1234567",
    "a header that is no JSON": struct.pack("<Q", 4) + b"nope",
    "a header that is a list": struct.pack("<Q", 2) + b"[]",
    "a nested header": struct.pack("<Q", 100_000) + b"[" * 100_000,
    "a pickle": b"\x80\x04\x95\x00\x00\x00\x00\x00\x00\x00\x00.",
    "a tensor beyond the file": struct.pack("<Q", 63)
    + b'{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,99999999999]}}'[:63],
}
INFOS = [
    *(("codebase_version", value, "expected codebase_version v3.0, got") for value in ("v2.1", 3, None)),
    *(("total_frames", value, "info.json") for value in ("many", None)),
    *(("total_frames", value, "in order, got 24") for value in (-1, HUGE, 23)),
    *(("total_episodes", value, "episodes") for value in (-1, HUGE, 3)),
    *((key, "many", "expected a LeRobot dataset: ValueError") for key in ("fps", "total_episodes")),
    *(("fps", value, "fps") for value in (0, -1)),
    *(("features", value, "info.json") for value in ({}, [], 5, None)),
    *(
        ("features:observation.images.third_person:shape", value, "info.json: expected a LeRobot dataset: ")
        for value in ([0, 0, 3], [HUGE] * 3, [-16, 16, 3], "big", [], None, [None])
    ),
]
FILES = {
    "text": "cannot be read",
    "": "cannot be read",
    "PAR1": "cannot be read",
}
TRAINING = {
    "--steps 0": "steps: expected greater than 0",
    "--steps -1": "steps: expected",
    "--batch-size 0": "batch_size: expected",
    "--learning-rate 0": "learning_rate: expected",
    "--learning-rate -1": "learning_rate: expected",
    "--schedule linear": "schedule: expected",
    "--action-steps 9": "expected 1 to 8 action steps",
    "--action-steps 0": "expected 1 to 8 action steps",
    "--shift -1": "shift: expected",
    "--seed -1": "seed: expected",
    "--threads 0": "threads: expected",
    "--rank 0": "expected a LoRA rank",
    "--rank 999999": "expected a LoRA rank",
    "--fresh-trunk -1": "--fresh-trunk",
    "--shift 99999": "largest_shift: expected less than or equal to 1024, got 99999",
    "--threads 1000000": "threads: expected less than or equal to 1024, got 1000000",
    "--batch-size 1000000000": "batch_size: expected less than or equal to 100000, got 1000000000",
}
MERGING = {
    "--operator tie": "unknown merge operator 'tie'; did you mean 'ties'?",
    "--masks tall": "masks: expected 'none', 'task', 'emr' or 'signs', got 'tall'",
    "--trunk sum": "trunk: expected 'mean' or 'vectors', got 'sum'",
    "--lambda 3": "expected lambda to be a number in (0, 2], got 3.0",
    "--lambda x": "expected --lambda NUMBER or EXPERT=NUMBER, got 'x'",
    "--lambda nan": "lambda",
    "--lambda ٣": "lambda",
    "--lambda auto": "expected --demonstrations with --lambda auto, got none",
    "--lambda null/Reac=1": "got 'null/Reac'; did you mean 'null/Reach'?",
    "--keep-blocks 3": "expected k, the blocks kept per task, to be a whole number in [0, 2]",
    "--keep-blocks -1": "expected k, the blocks kept per task, to be a whole number in [0, inf), got -1",
    "--rounds 0": "rounds",
    "--rounds 1000000000": "rounds",
    "--alpha 0": "alpha",
    "--option drop": "expected --option NAME=VALUE, got 'drop'",
    "--option drop=1": "operator 'ties' has no option 'drop'",
    "--bits 4": "operator 'ties' has no option 'bits'",
    "--only visio": "got 'visio'; did you mean 'vision'?",
    "--only language.0-9": "expected blocks 0 to 1 of the language model, got 'language.0-9'",
    "--operator none": "expected bits to be a whole number in [2, 8], got None",
    "--operator none --bits 1": "expected bits to be a whole number in [2, 8], got 1",
    "--operator none --bits 9": "expected bits to be a whole number in [2, 8], got 9",
    "--operator none --bits 99999999999999999999": "expected at most 1000000000",
    "--operator none --bits 4 --masks task": "expected masks 'none' where nothing is merged, got 'task'",
    "--operator none --bits 4 --option trim=0.1": "operator 'none' has no option 'trim'; it has: bits",
    "--operator wudi --option cutoff=1": "expected cutoff to be a number in [0, 1), got 1",
    "--operator wudi --option steps=3": "operator 'wudi' has no option 'steps'; it has: cutoff",
    "--operator ties-published --option trim=1": "expected trim to be a number in [0, 1), got 1",
    "--option density=much": "density",
    "--option density=9": "density",
    "--demonstrations nowhere": "expected a dataset",
    "--demonstrations text": "expected a dataset",
    "--demonstrations data/Reach": "got none of null/Slow",
}
DEMONSTRATING = {
    "null/Reech --out new": "'null/Reech'",
    "nul/* --out new": "nul",
    "smok --out new": "smok",
    "null/Reach --out text": "text: expected a folder",
    "null/Reach --out runs/monday": "runs/monday: expected a folder that is not a run folder",
    "null/Reach --out new --episodes 0": "episodes",
    "null/Reach --out new --episodes -1": "episodes",
    "null/Reach --out new --noise -1": "noise",
    "null/Reach --out new --noise 5": "noise",
    "null/Reach --out new --first-seed -1": "seed",
    "null/Reach --out new --workers 0": "workers",
    "null/Reach --out new --workers 1000000000": "workers",
    "null/Reach --out new --image-size 0": "image",
    "null/Reach --out new --image-size 1000000": "image",
    "null/Reach --out new --camera eye": "camera",
    "null/Reach --out new --whole": "whole: expected a learner",
    "null/Reach --out new --learner nowhere": "nowhere",
    "null/Reach --out new --learner notes": "notes",
    "null/Reach null/Reach --out text/x": "text",
}
IMPORTED = {
    "nope text --out new": "'nope' is not one of 'mergevla', 'vla-adapter', 'prismatic'",
    "mergevla nowhere --out new": "expected a folder or file of a released checkpoint, got 'nowhere'",
    "mergevla text --out new": "expected *.safetensors, *.pt or dataset_statistics.json, got 'text'",
    "mergevla notes --out new": "expected *.safetensors or *.pt in 'notes', got a folder without any",
    "mergevla {nul} --out new": "expected text in UTF-8 without control characters",
    "mergevla {name300} --out new": "expected names of at most 255 bytes",
    "mergevla base --out new": "expected the 1,437 tensors of 'mergevla', of which 1,437 (action_head.model.",
    "vla-adapter base --out new": "expected the 1,485 tensors of 'vla-adapter', of which",
    "prismatic base --out new": "expected the 968 tensors of 'prismatic', of which",
    "mergevla base base --out new": "expected each tensor once, got action_expert.blocks.0.",
    "mergevla base --out notes": "expected a new folder for --out, got 'notes'",
    "mergevla base --out text": "expected a new folder for --out, got 'text'",
    "prismatic base --out new --seed -1": "--seed",
}
RELEASED_FILES = {
    "x.pt": ("hello", "expected a file of torch.save in 'x.pt', got: "),
    "y.pt": ("", "expected a file of torch.save in 'y.pt', got: "),
    "z.pt": (b"\x80\x04\x8c\x05posix\x8c\x06system\x93.", "expected"),
    "x.safetensors": ("hello", "expected a safetensors file in 'x.safetensors', got: "),
    "a/dataset_statistics.json": ("{", "expected the statistics of a data set in 'a/dataset_statistics.json', got: "),
    "b/dataset_statistics.json": (
        "[" * 100_000,
        "expected the statistics of a data set in 'b/dataset_statistics.json'",
    ),
    "c/dataset_statistics.json": ('{"a": {"action": 5}}', "'c/dataset_statistics.json', got: "),
    "d/dataset_statistics.json": (b"\xff", "'d/dataset_statistics.json', got: "),
}
CASES = [
    *(Case(f"policies import {typed}", says) for typed, says in IMPORTED.items()),
    *(
        Case(f"policies import mergevla {file} --out new", says, {file: text})
        for file, (text, says) in RELEASED_FILES.items()
    ),
    *(Case(PLAY.format(policy), says, MODULES) for policy, says in REFERENCES.items()),
    *(Case(PLAY.format(policy), says) for policy, says in OPTIONS.items()),
    *(Case(SEARCH.format(*typed), says) for typed, says in SEARCHED.items()),
    *(Case(f"policies serve {policy} --port 0", REFERENCES[policy], MODULES) for policy in list(REFERENCES)[:12]),
    *(
        Case(f"policies check {policy} --task null/Reach --picture x.png", REFERENCES[policy], MODULES)
        for policy in list(REFERENCES)[:12]
    ),
    *(Case(MERGE, says, {CARD: partial(document_with, place, value)}) for place, value, says in CARDS),
    *(Case(MERGE, "card.json", {CARD: text}) for text in CARD_TEXTS),
    *(Case(PLAY.format("experts/null-Reach"), "card.json", {CARD: text}) for text in CARD_TEXTS),
    *(Case(MERGE, "safetensors", {WEIGHTS: content}) for content in HEADERS.values()),
    Case(MERGE, "card.json", {CARD: None}),
    Case(MERGE, "safetensors", {WEIGHTS: None}),
    *(Case(TRAIN, says, {INFO: partial(document_with, place, value)}) for place, value, says in INFOS),
    *(Case(TRAIN, "info.json", {INFO: text}) for text in CARD_TEXTS),
    *(Case(TRAIN, says, {file: content}) for file in (TASKS, FRAMES) for content, says in FILES.items()),
    *(Case(f"{TRAIN} {options}", says) for options, says in TRAINING.items()),
    *(Case(f"{MERGE} {options}", says) for options, says in MERGING.items()),
    *(Case(f"policies demonstrate {typed}", says) for typed, says in DEMONSTRATING.items()),
    *table(
        ("policies pretrain data/Reach --out new --size huge", "expected one of tiny"),
        ("policies pretrain data/Reach --out new", "expected 96 px images for architecture 'tiny'"),
        ("policies pretrain nowhere --out new", "expected a dataset"),
        ("policies pretrain text --out new", "expected a dataset"),
        ("policies pretrain data --out text", "text: expected a folder"),
        ("policies pretrain data/Reach --out new --schedule linear", "schedule: expected"),
        ("policies finetune data/Reach --base nowhere --out new", "expected a checkpoint's folder or a hub id"),
        ("policies finetune data/Reach --base data --out new", "expected card.json"),
        ("policies finetune data/Reach --base text --out new", "text"),
        ("policies finetune data/Reach --base base --out base", "expected a folder other than the base's"),
        ("policies finetune nowhere --base base --out new", "expected a dataset"),
        ("policies finetune data/Reach --base base --out text", "text: expected a folder"),
        ("policies finetune data/Reach --base experts/null-Reach --out new", "base"),
        ("policies merge base --out new", "expected an expert with adapters on a base"),
        ("policies merge nowhere --out new", "expected a checkpoint's folder or a hub id"),
        ("policies merge data --out new", "which holds none"),
        ("policies merge text --out new", "text"),
        ("policies merge experts/null-Reach experts/null-Reach --out new", "null/Reach"),
        ("policies merge experts --out notes", "expected a new folder or that of a merged checkpoint for --out"),
        ("policies merge experts --out experts/null-Reach", "expected a new folder or that of a merged checkpoint"),
        ("policies merge experts --out text", "text"),
        ("policies routing nowhere", "nowhere"),
        ("policies routing base", "expected a merged checkpoint, got a checkpoint of one network"),
        ("policies routing experts", "expected card.json in 'experts', got a folder without it"),
        ("policies routing base --keep text", "--keep: expected a folder, got the file 'text'"),
        ("policies routing base --json notes", "--json: expected a file in an existing folder, got 'notes'"),
        ("policies routing base --json nowhere/x", "--json: expected a file in an existing folder, got 'nowhere/x'"),
        ("policies check random --task null/Reech", "unknown task 'null/Reech'; did you mean 'null/Reach'?"),
        ("policies check random --picture x.jpg", "expected a file that ends in .png for --picture, got 'x.jpg'"),
        ("policies check random --task null/Reach --option sead=1", "policy 'random' has no option 'sead'"),
        ("policies serve random --host nowhere.invalid --port 0", "nowhere.invalid"),
        ("policies serve random --host 0.0.0.0 --port 0", "ROBOGAUNTLET_TOKEN"),
        ("policies new json", "a Python module 'json' exists already; choose another name"),
        ("policies new class", "a Python module 'class' exists already; choose another name"),
        *(
            (f"policies new '{name}'", "expected a name of up to 40 small letters, digits and single underscores")
            for name in ("My", "a b", "1x", "a-b", "../x", "é")
        ),
        ("policies new mine --out text", "text exists; give another folder with --out"),
        ("policies new mine --out notes", "notes exists; give another folder with --out"),
        ("policies new mine --out text/x", "text/x cannot be created: Not a directory"),
    ),
]
