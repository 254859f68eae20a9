#!/usr/bin/env bash
# Experts of two arms beside experts of one, on a base of two arms that all four tasks share: demonstrations, the base,
# the experts. Finished parts are skipped and stopped ones continue, so the same command goes on after any interruption.
# `TWO_ARMS=FOLDER python -m tests.benchmarks two_arms` merges and plays them.
# Usage: scripts/two_arms.sh [FOLDER]   (default runs/two-arms). Takes two hours on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=${1:-runs/two-arms${PERCENT:+-$PERCENT-percent}}
DATA="$FOLDER/demonstrations"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task, noise of its demonstrations, steps of its expert's training, further options: the longest first, so that both
# processes end together. ManiSkill's tasks ask the arm to stand still in the end, which the usual noise of 0.1 prevents.
EXPERTS="maniskill/TwoRobotPickCube-v1@TwoPandas 0.02 9000 --adapt-convolutions
robosuite/TwoArmLift@TwoPandas 0.1 6000
maniskill/PickCube-v1 0.02 4000
robosuite/Lift 0.1 1500"
export OMP_NUM_THREADS=1

demonstrate() {
    "$ROBOGAUNTLET" policies demonstrate "$1" --noise "$2" --out "$DATA/${1/\//__}" --episodes "$(few 150)" \
        --render-profile fast-2 --workers 1
}

expert() {
    local name="${1/\//__}" steps="$3"
    shift 3
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" policies finetune "$DATA/$name" --base "$FOLDER/base" --out "$FOLDER/experts/$name" \
            --steps "$(few "$steps")" --learning-rate 1e-3 --shift 2 --action-steps 4 "$@"
}
export -f demonstrate expert
export FOLDER DATA ROBOGAUNTLET
# A folder for each task, since one process at a time records into one.
xargs -P 2 -L 1 bash -euo pipefail -c 'demonstrate "$@"' demonstrate <<<"$EXPERTS"
[ -e "$FOLDER/base/card.json" ] ||
    OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE "$ROBOGAUNTLET" policies pretrain "$DATA"/* --out "$FOLDER/base" \
        --steps "$(few 3200)" --batch-size 64 --learning-rate 1.5e-3 --shift 2 --threads 2 --action-steps 4
xargs -P 2 -L 1 bash -euo pipefail -c 'expert "$@"' expert <<<"$EXPERTS"
