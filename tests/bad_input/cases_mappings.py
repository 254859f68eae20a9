"""Mapping files of gymnasium environments with a wrong value, and texts that are none."""

WRONG = [
    *(("horizon", value, "horizon: should be") for value in (0, -1, 1.5, "long", None, [], 10**18, float("nan"))),
    *(("control_hz", value, "control_hz: should be") for value in (0, -1, "fast", float("nan"), float("inf"), 1e300)),
    *(("max_translation", value, "max_translation: should be") for value in (-1, "far", float("nan"), float("inf"))),
    *(("instruction", value, "instruction: ") for value in ("", 5, None, "x" * 10_001)),
    *(("env", value, "env: ") for value in (5, None, [], "x" * 10_001)),
    *(("make", value, "make: ") for value in ("all", 5, [1])),
    *(("action", value, "action") for value in ({}, [], 5, {"dw": {"index": 0, "scale": 1}}, {"dx": 5})),
    *(("action.dx.index", value, "action.dx.index: should be") for value in (-1, "first", 1.5, 10**18)),
    *(("action.dx.scale", value, "action.dx.scale: should be") for value in ("big", None, float("nan"), float("inf"))),
    *(("base.position", value, "base.position") for value in ([0, 0], [0, 0, "x"], 5, [0, 0, float("nan")])),
    *(("base.yaw", value, "base.yaw: should be") for value in ("left", float("inf"))),
    *(("reads", value, "reads") for value in (5, [5], ["_x"], ["a..b"], ["a.__class__"], ["x" * 1_001])),
    *(("state", value, "state: ") for value in (5, [], None)),
    *(("state.tcp_position", value, "state.tcp_position") for value in (None, {}, [None], "observation[", "x" * 1_001)),
    *(
        ("success", expression, says)
        for expression, says in {
            "": "is no expression such as observation[0:3]",
            "1 +": "is no expression such as observation[0:3]",
            "lambda: 1": "only names, [items], numbers",
            "observation.shape": "only",
            "open('/etc/passwd')": "calls of one argument of: abs, all",
            "abs(1, 2)": "calls of one argument of: abs, all",
            "9 ** 9 ** 9": "only names, [items], numbers",
            "'a' * 10": "only names, [items], numbers",
            "unwrapped": "expected one of its attributes, such as unwrapped.data.qpos",
            "unwrapped.make()": "expected only unwrapped.data.KIND",
            "unwrapped.__class__": "none of which begins with _",
            "f'{observation}'": "only names, [items], numbers",
            "-" * 900 + "1": "expected 40 levels of brackets and operators at most",
            "1 if reward else 2": "only names, [items], numbers",
        }.items()
    ),
    *(("cameras.third_person", value, "cameras.third_person") for value in (5, None, [], {"at": [0, 0, 0]})),
    *(("goal", value, "goal: should be") for value in (5, "tcp_position", [])),
    *(
        ("goal", {"entry": "tcp_position", **values}, says)
        for values, says in (
            ({"to": "tcp_postion"}, "goal.to: no 'tcp_postion' in `state`; did you mean 'tcp_position'?"),
            ({"handle": "lid", "offset": [0.1]}, "goal.handle: no 'lid' in `state`; known: "),
            ({"entry": ""}, "goal: entry: expected the name of an entry"),
            ({"entry": "x" * 10_001}, "goal.entry: "),
            ({"axes": "xw"}, "goal: axes: expected letters out of 'xyz', each at most once, such as 'xy', found 'xw'"),
            ({"axes": ""}, "goal: axes: expected letters out of 'xyz'"),
            ({"offset": [0.1, 0.2]}, "goal: offset: expected 1 or 3 finite numbers"),
            ({"offset": [float("nan")]}, "goal.offset.0: should be a finite number"),
            ({"tolerance": -1}, "goal: tolerance: expected a finite number, 0 or more, found -1"),
            ({"grasped": "perhaps"}, "goal.grasped: should be a valid boolean"),
            ({"tolerence": 1}, "unknown key 'goal.tolerence'; did you mean 'tolerance'?"),
        )
    ),
    ("goal", {"to": "tcp_position"}, "missing key 'goal.entry'"),
    ("tcp", 1, "unknown key 'tcp'; known: "),
    ("y" * 5_000, 1, "unknown key 'yyy"),
    ("a\nb", 1, "unknown key 'a\\nb'"),
    ("instrution", "x", "unknown key 'instrution'; did you mean 'instruction'?"),
    ("terminates", False, "terminates: should be"),
]
"""Place in the mapping, value, and a part of the answer."""
TEXTS = {
    b"": "file: should be",
    b"- 1": "file: should be",
    b"5": "file: should be",
    b"a: [": "not a mapping file, line 1: not YAML",
    b"a: 1\na: 2": "line 2: duplicate key 'a'",
    b"a: &a [*a]": "an alias that contains itself",
    b"a: !!python/object:os.x {}": "found the tag",
    b"\xff": "expected UTF-8 text, found byte 0xff",
    b"a: \0": "not YAML: character U+0000",
    b"[" * 100: "expected at most 50 lists and mappings inside each other",
    b"a" * 1_000_001: "expected a mapping file of at most 1000000 bytes",
}
