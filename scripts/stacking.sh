#!/usr/bin/env bash
# What limits the zoo's experts of Stack and StackCube: the same by other trainings. Demonstrations, as many as the zoo's
# and 2000, corrections of the zoo's experts (DAgger), experts. Finished parts are skipped and stopped ones continue, so
# the same command goes on after any interruption. `STACKING=FOLDER python -m tests.benchmarks stacking` plays them beside
# the zoo's.
# Usage: scripts/stacking.sh [FOLDER]   (default runs/stacking). Takes some four hours and 16 GB of memory on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=${1:-runs/stacking${PERCENT:+-$PERCENT-percent}}
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task, number of demonstrations of the zoo's expert.
TASKS="robosuite/Stack 700
maniskill/StackCube-v1 500"
# Name of a training, task, its action steps, steps, learning rate, datasets. The zoo's have 14000 steps (Stack) and
# 12000 (StackCube), a rate of 1e-3 and demonstrations alone.
TRAININGS="longer robosuite/Stack 8 21000 1e-3 demonstrations
corrected robosuite/Stack 8 14000 1e-3 demonstrations corrections
corrected maniskill/StackCube-v1 2 14000 1e-3 demonstrations corrections
corrected-slowly maniskill/StackCube-v1 2 12000 5e-4 demonstrations corrections
slowly maniskill/StackCube-v1 2 12000 5e-4 demonstrations
more robosuite/Stack 8 20000 7e-4 more-demonstrations
more maniskill/StackCube-v1 2 20000 7e-4 more-demonstrations"
export OMP_NUM_THREADS=1

demonstrate() {
    local out="$FOLDER/$1/${2/\//__}"
    "$ROBOGAUNTLET" policies demonstrate "$2" --out "$out" --episodes "$(few "$3")" --render-profile fast-2 \
        --workers 1 "${@:4}"
}

record() {
    demonstrate demonstrations "$@"
    demonstrate more-demonstrations "$1" 2000
    demonstrate corrections "$1" 400 --learner zoo:experts --whole --first-seed 1500000
}

train() {
    local name="${2/\//__}" data=()
    local out="$FOLDER/experts/$1/$name"
    for kind in "${@:6}"; do data+=("$FOLDER/$kind/$name/$name"); done
    [ -e "$out/card.json" ] ||
        "$ROBOGAUNTLET" policies finetune "${data[@]}" --base zoo:base --out "$out" --steps "$(few "$4")" \
            --learning-rate "$5" --shift 2 --adapt-convolutions --action-steps "$3"
}
export -f demonstrate record train
export FOLDER ROBOGAUNTLET
# A folder for each task, since one process at a time records into one.
xargs -P 2 -L 1 bash -euo pipefail -c 'record "$@"' record <<<"$TASKS"
xargs -P 2 -L 1 bash -euo pipefail -c 'train "$@"' train <<<"$TRAININGS"
