#!/usr/bin/env bash
# Makes the zoo from nothing: demonstrations of the nine tasks, the base, nine experts, the merged models. Each step is
# skipped if its result is there and continued if it was stopped, so the same command goes on after any interruption.
# Usage: scripts/zoo.sh [FOLDER]   (default runs/zoo; `make zoo`). Takes hours on two cores; progress is printed.
set -euo pipefail
cd "$(dirname "$0")/.."
FOLDER=${1:-runs/zoo}
DATA="$FOLDER/demonstrations"
GAUNTLET=${GAUNTLET:-.venv/bin/gauntlet}
TASKS=(maniskill/PushCube-v1 maniskill/PullCube-v1 maniskill/StackCube-v1 robosuite/Lift robosuite/Stack robosuite/Door
    pybullet/PandaReach-v3 pybullet/PandaPush-v3 pybullet/PandaPickAndPlace-v3)
export OMP_NUM_THREADS=1

finished() { [ -e "$1/card.json" ]; }

"$GAUNTLET" policies demonstrate "${TASKS[@]}" --out "$DATA" --episodes 150 --workers 2
finished "$FOLDER/base" ||
    "$GAUNTLET" policies pretrain "$DATA" --out "$FOLDER/base" --steps 8000 --batch-size 64 --threads 2

expert() {
    local name="${1/\//__}"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$GAUNTLET" policies finetune "$DATA/$name" --base "$FOLDER/base" --out "$FOLDER/experts/$name" --steps 1500
}
export -f expert
export FOLDER DATA GAUNTLET
printf '%s\n' "${TASKS[@]}" | xargs -P 2 -I{} bash -c 'expert {}'
