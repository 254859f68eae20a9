#!/usr/bin/env bash
# Makes the zoo from nothing: demonstrations of the nine tasks, the base, nine experts, the merged models. Each step is
# skipped if its result is there and continued if it was stopped, so the same command goes on after any interruption.
# Usage: scripts/zoo.sh [FOLDER]   (default runs/zoo; `make zoo`). Takes hours on two cores; progress is printed.
set -euo pipefail
cd "$(dirname "$0")/.."
FOLDER=${1:-runs/zoo}
DATA="$FOLDER/demonstrations"
GAUNTLET=${GAUNTLET:-.venv/bin/gauntlet}
# Task, steps of its expert's training and demonstrations: the longest first, so that both processes end together. Five
# tasks were short of success with 150 demonstrations, the others were not.
EXPERTS="maniskill/StackCube-v1 7000 500
robosuite/Stack 6000 300
pybullet/PandaPickAndPlace-v3 5000 400
pybullet/PandaPush-v3 5000 500
pybullet/PandaReach-v3 4000 600
robosuite/Door 1800 150
maniskill/PushCube-v1 1500 150
robosuite/Lift 1500 150
maniskill/PullCube-v1 1300 150"
export OMP_NUM_THREADS=1

finished() { [ -e "$1/card.json" ]; }

"$GAUNTLET" policies demonstrate 'maniskill/*' 'robosuite/*' 'pybullet/*' --out "$DATA" --episodes 150 --workers 2
finished "$FOLDER/base" ||
    OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE "$GAUNTLET" policies pretrain "$DATA" --out "$FOLDER/base" \
        --steps 3200 --batch-size 64 --learning-rate 1.5e-3 --shift 2 --threads 2

while read -r task _ demonstrations; do
    "$GAUNTLET" policies demonstrate "$task" --out "$DATA" --episodes "$demonstrations" --workers 2 </dev/null
done <<<"$EXPERTS"

expert() {
    local name="${1/\//__}"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$GAUNTLET" policies finetune "$DATA/$name" --base "$FOLDER/base" --out "$FOLDER/experts/$name" \
            --steps "$2" --learning-rate 1e-3 --shift 2
}
export -f expert
export FOLDER DATA GAUNTLET
xargs -P 2 -L 1 bash -c 'expert "$0" "$1"' <<<"$EXPERTS"

finished "$FOLDER/merged" ||
    "$GAUNTLET" policies merge "$FOLDER/experts" --out "$FOLDER/merged" --operator magnitude --keep-blocks 1 --rounds 2 \
        --demonstrations "$DATA"
