#!/usr/bin/env bash
# Trains experts of Stack and StackCube in other ways than the zoo's: records demonstrations, trains experts on them,
# records corrections of the experts from few demonstrations (DAgger), and trains on those too. Finished parts are
# skipped and stopped ones continue, so the same command goes on after any interruption.
# `STACKING=FOLDER python -m studies merging --measure stacking` plays them beside the zoo's.
# Usage: studies/merging/stacking.sh [FOLDER]   (default runs/stacking). Takes some four hours on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/stacking${PERCENT:+-$PERCENT-percent}}
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task, number of demonstrations; the zoo's experts have 2000.
TASKS="robosuite/Stack 700
maniskill/StackCube-v1 500"
# Name of a training, task, its action steps, steps, learning rate, datasets.
TRAININGS="fewer robosuite/Stack 8 14000 1e-3 fast
fewer maniskill/StackCube-v1 2 12000 1e-3 fast
longer robosuite/Stack 8 21000 1e-3 fast-2
slowly maniskill/StackCube-v1 2 12000 5e-4 fast-2"
CORRECTED="corrected robosuite/Stack 8 14000 1e-3 fast-2 corrections
corrected maniskill/StackCube-v1 2 14000 1e-3 fast-2 corrections
corrected-slowly maniskill/StackCube-v1 2 12000 5e-4 fast-2 corrections"
export OMP_NUM_THREADS=1

# A folder for each task, since one process at a time records into one: its dataset, task, number, render profile.
demonstrate() {
    "$ROBOGAUNTLET" new demonstrations "$2" --out "$FOLDER/$1/${2/\//__}" --episodes "$(few "$3")" \
        --render-profile "$4" --workers 1 "${@:5}"
}
record() {
    demonstrate fast "$@" fast
    demonstrate fast-2 "$@" fast-2
}
correct() {
    demonstrate corrections "$1" 400 fast-2 --learner "$FOLDER/experts/fewer" --whole --first-seed 1500000
}

train() {
    local name="${2/\//__}" data=()
    local out="$FOLDER/experts/$1/$name"
    for kind in "${@:6}"; do data+=("$FOLDER/$kind/$name/$name"); done
    [ -e "$out/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "${data[@]}" --base zoo:base --out "$out" --steps "$(few "$4")" \
            --learning-rate "$5" --shift 2 --adapt-convolutions --action-steps "$3"
}
export -f demonstrate record correct train
export FOLDER ROBOGAUNTLET
side_by_side() { xargs -P 2 -L 1 bash -euo pipefail -c "$1"' "$@"' "$1"; }
side_by_side record <<<"$TASKS"
side_by_side train <<<"$TRAININGS"
side_by_side correct <<<"$TASKS"
side_by_side train <<<"$CORRECTED"
