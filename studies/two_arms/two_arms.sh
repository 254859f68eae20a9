#!/usr/bin/env bash
# Experts of two arms beside experts of one, on a base of two arms: demonstrations, the base, the experts. Finished parts are skipped and stopped ones continue, so the same command goes on after any interruption.
# `TWO_ARMS=FOLDER python -m studies two_arms --measure two_arms` merges and plays them.
# Usage: studies/two_arms/two_arms.sh [FOLDER]   (default runs/two-arms). Takes two hours on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/two-arms${PERCENT:+-$PERCENT-percent}}
DATA="$FOLDER/demonstrations"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task and noise of its demonstrations. Two of ManiSkill's tasks ask the arm to stand still in the end, which the usual
# noise of 0.1 prevents.
OF_THE_BASE="maniskill/TwoRobotPickCube-v1@TwoPandas 0.02
robosuite/TwoArmLift@TwoPandas 0.1
maniskill/PickCube-v1 0.02
robosuite/Lift 0.1"
# Task, steps of its expert's training, further options: the longest first, so that both processes end together.
EXPERTS="maniskill/TwoRobotPickCube-v1@TwoPandas 9000 --adapt-convolutions --action-steps 1
robosuite/TwoArmLift@TwoPandas 6000 --action-steps 4
robosuite/Lift 1500 --action-steps 4
maniskill/PushCube-v1 1500 --action-steps 4"
export OMP_NUM_THREADS=1

demonstrate() {
    "$ROBOGAUNTLET" new demonstrations "$1" --noise "$2" --out "$DATA/${1/\//__}" --episodes "$(few 150)" \
        --render-profile fast-2 --workers 1
}

expert() {
    local name="${1/\//__}" steps="$2"
    shift 2
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "$DATA/$name" --base "$FOLDER/base" --out "$FOLDER/experts/$name" \
            --steps "$(few "$steps")" --learning-rate 1e-3 --shift 2 "$@"
}
export -f demonstrate expert
export FOLDER DATA ROBOGAUNTLET
# A folder for each task, since one process at a time records into one.
xargs -P 2 -L 1 bash -euo pipefail -c 'demonstrate "$@"' demonstrate <<<"$OF_THE_BASE"
mapfile -t datasets < <(sed "s|/|__|; s| .*||; s|^|$DATA/|" <<<"$OF_THE_BASE")
[ -e "$FOLDER/base/card.json" ] ||
    OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE "$ROBOGAUNTLET" mergevla pretrain "${datasets[@]}" --out "$FOLDER/base" \
        --steps "$(few 3200)" --batch-size 64 --learning-rate 1.5e-3 --shift 2 --threads 2 --action-steps 4
demonstrate maniskill/PushCube-v1 0.1
xargs -P 2 -L 1 bash -euo pipefail -c 'expert "$@"' expert <<<"$EXPERTS"
