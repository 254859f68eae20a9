#!/usr/bin/env bash
# Makes the zoo from nothing: demonstrations of the nine tasks, the base, nine experts, the merged models. Each step is
# skipped if its result is there and continued if it was stopped, so the same command goes on after any interruption.
# Usage: scripts/zoo.sh [FOLDER]   (default runs/zoo; `make zoo`). Takes hours and 16 GB of memory on two cores; progress
# is printed.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=${1:-runs/zoo${PERCENT:+-$PERCENT-percent}}
DATA="$FOLDER/demonstrations/fast"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
CORRECTED=pybullet/PandaPush-v3
# Task, demonstrations and their render profile, steps and learning rate of its expert's training, further options: the
# longest first, so that both processes end together. Five tasks have more than 150 demonstrations, since their success
# was low; three of them adapt convolutions too.
EXPERTS="robosuite/Stack 2000 fast-2 20000 7e-4 --adapt-convolutions --action-steps 8
maniskill/StackCube-v1 2000 fast-2 20000 7e-4 --adapt-convolutions --action-steps 2
$CORRECTED 500 fast 9000 1e-3 --adapt-convolutions --action-steps 4
pybullet/PandaPickAndPlace-v3 400 fast 5000 1e-3 --action-steps 4
pybullet/PandaReach-v3 600 fast 4000 1e-3 --action-steps 4
robosuite/Door 150 fast 1800 1e-3 --action-steps 4
maniskill/PushCube-v1 150 fast 1500 1e-3 --action-steps 4
robosuite/Lift 150 fast 1500 1e-3 --action-steps 4
maniskill/PullCube-v1 150 fast 1300 1e-3 --action-steps 4"
export OMP_NUM_THREADS=1

finished() { [ -e "$1/card.json" ]; }

"$ROBOGAUNTLET" new demonstrations maniskill/{PushCube,PullCube,StackCube}-v1 robosuite/{Lift,Stack,Door} 'pybullet/*' --out "$DATA" --episodes "$(few 150)" --workers 2
finished "$FOLDER/base" ||
    OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE "$ROBOGAUNTLET" mergevla pretrain "$DATA" --out "$FOLDER/base" \
        --steps "$(few 3200)" --batch-size 64 --learning-rate 1.5e-3 --shift 2 --threads 2 --action-steps 4

while read -r task demonstrations profile _; do
    "$ROBOGAUNTLET" new demonstrations "$task" --out "$FOLDER/demonstrations/$profile" --render-profile "$profile" \
        --episodes "$(few "$demonstrations")" --workers 2 </dev/null
done <<<"$EXPERTS"

# Folder of the expert, its datasets (one or two), steps, learning rate, further options.
train() {
    local out="$1" data="$2" steps="$3" rate="$4"
    shift 4
    # shellcheck disable=SC2086  # datasets are several words
    [ -e "$out/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune $data --base "$FOLDER/base" --out "$out" --steps "$(few "$steps")" \
            --learning-rate "$rate" --shift 2 "$@"
}

# One task's expert learns from being corrected as well (DAgger): a first expert acts, the oracle takes over from it.
name="${CORRECTED/\//__}"
train "$FOLDER/first/$name" "$DATA/$name" 5000 1e-3 --action-steps 4
"$ROBOGAUNTLET" new demonstrations "$CORRECTED" --learner "$FOLDER/first" --whole --out "$FOLDER/corrections" \
    --episodes "$(few 300)" --first-seed 1500000 --workers 2

expert() {
    local task="$1" name="${1/\//__}"
    local data="$FOLDER/demonstrations/$3/$name"
    [ "$task" != "$CORRECTED" ] || data="$data $FOLDER/corrections/$name"
    shift 3
    train "$FOLDER/experts/$name" "$data" "$@"
}
export -f expert train
export FOLDER DATA ROBOGAUNTLET CORRECTED
xargs -P 2 -L 1 bash -c 'expert "$@"' expert <<<"$EXPERTS"

merge() {
    local out="$FOLDER/$1"
    shift
    finished "$out" ||
        "$ROBOGAUNTLET" mergevla merge "$FOLDER/experts" --out "$out" --no-weights --demonstrations "$DATA" \
            "$@"
}
merge merged --operator magnitude --keep-blocks 1 --rounds 2
merge unmerged-int4 --operator none --masks none --bits 4 --router calibrated --router nearest-centroid
