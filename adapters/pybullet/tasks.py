"""The tasks of panda-gym that this adapter opens."""

from robogauntlet.adapters.contract import Goal, TaskDescription

TASKS = {
    "PandaReach-v3": TaskDescription(
        "reach the red ball with the closed gripper",
        horizon=20,
        fixed={"dynamics": "the arm can move nothing in it"},
        goal=Goal("tcp_position", "goal_position", tolerance=0.05),
    ),
    "PandaPush-v3": TaskDescription(
        "push the green cube onto the red goal",
        horizon=100,
        goal=Goal("cube_position", "goal_position", tolerance=0.05),
    ),
    "PandaPickAndPlace-v3": TaskDescription(
        "pick up the green cube and carry it to the red goal",
        horizon=60,
        goal=Goal("cube_position", "goal_position", tolerance=0.05, grasped=True),
    ),
}
