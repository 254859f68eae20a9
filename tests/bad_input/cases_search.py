"""Searches for worst cases: budgets, axes, policies, tasks and folders."""

from tests.bad_input.case import Case

SEARCH = "search --policy random --task null/Reach --out new"
NULL = "null simulator (no physics) does not let its cameras be adjusted"
BUDGET = "--budget: expected at least"

CASES = [
    Case("search --policy random --task null/Reach", "Missing option '--budget'"),
    Case("search --task null/Reach --budget 100", "Missing option '--policy'"),
    Case("search --policy random --budget 100", "Missing option '--task'"),
    *(
        Case(f"{SEARCH} {rest}", says)
        for rest, says in {
            "--budget 0": "expected a value greater than or equal to 1",
            "--budget few": "'few' is not a valid integer",
            "--budget 100 --axis noise --below 0": "expected a value greater than or equal to 5",
            "--budget 100 --axis noise --below 96": "expected a value less than or equal to 95",
            "--budget 100 --axis noise --seed=-1": "expected a value greater than or equal to 0",
            "--budget 100 --axis noise --optoin x=1": "No such option",
            "--budget 39 --axis noise": f"{BUDGET} 40 episodes for 1 axis on 1 task, got 39",
            "--budget 40 --axis noise --axis blur": f"{BUDGET} 100 episodes for 2 axes on 1 task, or fewer axes with",
            "--budget 79 --axis noise --task null/Slow": f"{BUDGET} 80 episodes for 1 axis on 2 tasks, got 79",
            "--budget 60000 --axis noise": "--budget: expected at most 50000 episodes per task, got 60000",
            "--budget 100 --axis nois": "--axis: expected a perturbation axis, got 'nois'; did you mean 'noise'?",
            "--budget 100 --axis blind": "--axis: expected a perturbation axis, got 'blind'",
            "--budget 100 --axis noise@2": "--axis: expected a perturbation axis, got 'noise@2'; did you mean 'noise'?",
            "--budget 100 --axis noise --axis noise": "--axis: expected each axis once, got 'noise' twice",
            "--budget 100 --axis camera-orbit": f"--axis camera-orbit: null/Reach cannot have it: {NULL}",
            "--budget 100 --axis noise --option nope=1": "policy 'random' has no option 'nope'",
            "--budget 100 --axis noise --task null/Reech": "unknown task 'null/Reech'; did you mean 'null/Reach'?",
        }.items()
    ),
    Case("search --policy randm --task null/Reach --budget 100", "did you mean 'random'?"),
    Case(
        "search --policy random --task null/Reach --budget 100 --axis noise --out notes",
        "notes: expected a new folder or that of a search, it has other files",
    ),
    Case(
        "search --policy random --task null/Reach --budget 100 --axis noise --out runs/monday",
        "runs/monday: expected a new folder or that of a search, it has other files",
    ),
    Case(
        "search --policy random --task null/Reach --budget 100 --axis noise --out text",
        "text: expected a folder, this is a file",
    ),
    Case(
        "search --policy random --task null/Reach --budget 100 --axis noise --out notes",
        "notes: its search has another 'policy'; give another folder with --out",
        {"notes/search.json": "{}"},
    ),
    Case(
        "search --policy random --task null/Reach --budget 100 --axis noise --out notes",
        "notes/search.json: Expecting",
        {"notes/search.json": "{"},
    ),
]
