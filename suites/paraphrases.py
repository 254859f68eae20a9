"""Paraphrases of the tasks' instructions, one per severity, and instructions that ask for another goal.

1 adds a filler, 2 uses synonyms, 3 changes the syntax, 4 refers to objects by kind or place, 5 adds an irrelevant
clause. Sentences have at most 15 words.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PARAPHRASES: Mapping[str, tuple[str, str, str, str, str]] = MappingProxyType(
    {
        "push the blue cube onto the red and white target": (
            "please push the blue cube onto the red and white target",
            "shove the blue block onto the red and white goal",
            "onto the red and white target the blue cube should be pushed",
            "push the only blue object away from you onto the ringed disc",
            "ignore the radio and push the blue cube onto the red and white target",
        ),
        "pull the blue cube onto the red and white target": (
            "please pull the blue cube onto the red and white target",
            "drag the blue block onto the red and white goal",
            "onto the red and white target the blue cube should be pulled",
            "pull the only blue object towards you onto the ringed disc",
            "ignore the radio and pull the blue cube onto the red and white target",
        ),
        "stack the red cube on top of the green cube": (
            "please stack the red cube on top of the green cube",
            "place the red block on top of the green block",
            "on top of the green cube the red cube should be stacked",
            "stack the cube that is not green on top of the other one",
            "it is raining outside so stack the red cube on top of the green cube",
        ),
        "hand the red cube to the other arm at the green ball": (
            "please hand the red cube to the other arm at the green ball",
            "pass the red block to the other arm at the green sphere",
            "to the other arm at the green ball the red cube should be handed",
            "give the only thing on the table to your partner at the floating target",
            "it rains so hand the red cube to the other arm at the green ball",
        ),
        "lift the pot by its two handles": (
            "please lift the pot by its two handles",
            "raise the saucepan by both of its grips",
            "by its two handles the pot should be lifted",
            "raise the only thing on the table by its green and its blue bar",
            "the kitchen is closed today so lift the pot by its two handles",
        ),
        "put the red cube on the blue disc": (
            "please put the red cube on the blue disc",
            "place the red block on the blue circle",
            "on the blue disc the red cube should be put",
            "put the only thing that can be gripped on the flat round mark",
            "the printer is out of paper so put the red cube on the blue disc",
        ),
        "push the green cube onto the yellow disc": (
            "please push the green cube onto the yellow disc",
            "shove the green block onto the yellow circle",
            "onto the yellow disc the green cube should be pushed",
            "push the only thing that can be moved onto the flat round mark",
            "somebody is at the door so push the green cube onto the yellow disc",
        ),
        "stack the red cube on the green cube": (
            "please stack the red cube on the green cube",
            "pile the red block on the green block",
            "on the green cube the red cube should be stacked",
            "stack the cube that is not green on the other one",
            "the meeting is over so stack the red cube on the green cube",
        ),
        "reach the red ball with the closed gripper": (
            "please reach the red ball with the closed gripper",
            "touch the red sphere with the shut hand",
            "with the closed gripper the red ball should be reached",
            "reach the round red thing with the fingers kept together",
            "lunch is at noon today but reach the red ball with the closed gripper",
        ),
        "push the green cube onto the red goal": (
            "please push the green cube onto the red goal",
            "shove the green block onto the red target",
            "onto the red goal the green cube should be pushed",
            "push the cube that can be moved onto the place marked in red",
            "the floor was swept yesterday now push the green cube onto the red goal",
        ),
        "pick up the green cube and carry it to the red goal": (
            "please pick up the green cube and carry it to the red goal",
            "grasp the green block and bring it to the red target",
            "to the red goal the green cube should be picked up and carried",
            "pick up the cube and carry it to the place marked in red",
            "it rains outside; pick up the green cube and carry it to the red goal",
        ),
        "lift the red cube off the table": (
            "please lift the red cube off the table",
            "raise the red block off the desk",
            "off the table the red cube should be lifted",
            "lift the only object here off the surface that it lies on",
            "it is raining outside so lift the red cube off the table",
        ),
        "put the red cube on the green cube": (
            "please put the red cube on the green cube",
            "place the red block on the green block",
            "on the green cube the red cube should be put",
            "put the smaller of the two cubes on the larger one",
            "lunch is at noon today but put the red cube on the green cube",
        ),
        "turn the handle down and pull the door open": (
            "please turn the handle down and pull the door open",
            "press the handle down and draw the door open",
            "the door should be pulled open after the handle is turned down",
            "work the lever and open what it keeps shut",
            "the floor was swept yesterday now turn the handle down and pull the door open",
        ),
        "pick up the red cube and hold it in the green ball": (
            "please pick up the red cube and hold it in the green ball",
            "grasp the red block and keep it inside the green sphere",
            "in the green ball the red cube should be held",
            "take the only block to the round green thing and stay there",
            "dinner is late pick up the red cube and hold it in the green ball",
        ),
        "put the blue sphere into the bin": (
            "please put the blue sphere into the bin",
            "place the blue ball into the box",
            "into the bin the blue sphere should be put",
            "put the round thing into the small open container",
            "the lamp was bought last week so put the blue sphere into the bin",
        ),
        "build a pyramid with the blue cube on the other two": (
            "please build a pyramid with the blue cube on the other two",
            "make a pyramid with the blue block above the other two",
            "a pyramid should be built whose top is the blue cube",
            "join two cubes and put the one that is neither red nor green above",
            "it rains so build a pyramid with the blue cube on the other two",
        ),
        "put the red can into its compartment of the bin": (
            "please put the red can into its compartment of the bin",
            "place the red tin into its section of the box",
            "into its compartment of the bin the red can should be put",
            "put the round container where its faint copy stands",
            "it is windy outside so put the red can into its compartment of the bin",
        ),
        "put the milk carton into its compartment of the bin": (
            "please put the milk carton into its compartment of the bin",
            "place the milk pack into its section of the box",
            "into its compartment of the bin the milk carton should be put",
            "put the tall white container where its faint copy stands",
            "the clock is wrong so put the milk carton into its compartment of the bin",
        ),
        "put the bread into its compartment of the bin": (
            "please put the bread into its compartment of the bin",
            "place the loaf into its section of the box",
            "into its compartment of the bin the bread should be put",
            "put the brown thing where its faint copy stands",
            "a phone rings next door but put the bread into its compartment of the bin",
        ),
        "put the cereal box into its compartment of the bin": (
            "please put the cereal box into its compartment of the bin",
            "place the cereal pack into its section of the box",
            "into its compartment of the bin the cereal box should be put",
            "put the flat tall thing where its faint copy stands",
            "the tea is cold so put the cereal box into its compartment of the bin",
        ),
        "put the square nut on the square peg": (
            "please put the square nut on the square peg",
            "place the square nut over the square pin",
            "on the square peg the square nut should be put",
            "put the angular ring over the pole that it fits",
            "the shop closes at six so put the square nut on the square peg",
        ),
        "put the round nut on the round peg": (
            "please put the round nut on the round peg",
            "place the round nut over the round pin",
            "on the round peg the round nut should be put",
            "put the ring without corners over the pole that it fits",
            "the garden needs water but put the round nut on the round peg",
        ),
    }
)
"""Instruction to its five paraphrases."""
OTHER_GOALS: Mapping[str, str] = MappingProxyType(
    {
        "push the blue cube onto the red and white target": "pull the blue cube away from the red and white target",
        "pull the blue cube onto the red and white target": "push the blue cube away from the red and white target",
        "stack the red cube on top of the green cube": "stack the green cube on top of the red cube",
        "reach the red ball with the closed gripper": "keep the closed gripper away from the red ball",
        "push the green cube onto the red goal": "pick up the green cube and hold it above the table",
        "pick up the green cube and carry it to the red goal": "push the green cube off the table",
        "lift the red cube off the table": "push the red cube across the table",
        "put the red cube on the green cube": "put the green cube on the red cube",
        "turn the handle down and pull the door open": "leave the handle alone and keep the door shut",
        "pick up the red cube and hold it in the green ball": "push the red cube away from the green ball",
        "put the blue sphere into the bin": "roll the blue sphere away from the bin",
        "build a pyramid with the blue cube on the other two": "build a pyramid with the red cube on the other two",
        "put the red can into its compartment of the bin": "leave the red can and move the gripper over the empty bin",
        "put the milk carton into its compartment of the bin": "lift the milk carton and hold it above its place",
        "put the bread into its compartment of the bin": "push the bread into a corner of its bin",
        "put the cereal box into its compartment of the bin": "lay the cereal box down where it is",
        "put the square nut on the square peg": "put the square nut on the round peg",
        "put the round nut on the round peg": "put the round nut on the square peg",
        # LIBERO's suite goal has one scene, so these are each other's. Stoves are turned on in other scenes too.
        "open the middle drawer of the cabinet": "push the plate to the front of the stove",
        "put the bowl on the stove": "put the bowl on the plate",
        "put the wine bottle on top of the cabinet": "put the cream cheese in the bowl",
        "open the top drawer and put the bowl inside": "put the bowl on the stove",
        "put the bowl on top of the cabinet": "put the wine bottle on top of the cabinet",
        "push the plate to the front of the stove": "open the middle drawer of the cabinet",
        "put the cream cheese in the bowl": "turn on the stove",
        "put the bowl on the plate": "put the bowl on top of the cabinet",
        "put the wine bottle on the rack": "put the wine bottle on top of the cabinet",
    }
)
"""Instruction to one with another goal that is possible in the same scene."""


def why_unsupported(axis: str, instruction: str) -> str | None:
    """Return the reason why a task with this instruction cannot have an axis, or None if it can."""
    known = {"instruction": PARAPHRASES, "wrong-goal": OTHER_GOALS}.get(axis, {instruction})
    return None if instruction in known else f"suites/paraphrases.py has no paraphrases of '{instruction}'"
