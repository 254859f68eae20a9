#!/usr/bin/env bash
# Experts of other arms of robosuite, on the zoo's base: demonstrations and an expert of each task, as scripts/zoo.sh
# makes those of the Panda. Finished parts are skipped and stopped ones continue, so the same command goes on after any
# interruption. `ARMS=FOLDER python -m tests.benchmarks arms` merges and plays them.
# Usage: scripts/arms.sh [FOLDER] [TASK...]   (default runs/arms and the tasks below). Takes an hour on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=${1:-runs/arms${PERCENT:+-$PERCENT-percent}}
shift || true
TASKS=${*:-robosuite/Door@Kinova3 robosuite/Lift@UR5e robosuite/Lift@Kinova3 robosuite/Lift@IIWA robosuite/Lift@Jaco robosuite/Lift@XArm7}
OF_THE_ZOO="robosuite/Stack robosuite/Lift"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
export OMP_NUM_THREADS=1

# A folder for each task, since one process at a time records into one.
demonstrate() {
    "$ROBOGAUNTLET" policies demonstrate "$1" --out "$FOLDER/demonstrations/${1/\//__}" --episodes "$(few 150)" \
        --render-profile fast-2 --workers 1
}

# As many steps as the zoo's experts of the same tasks have.
expert() {
    local name="${1/\//__}" steps=1500
    case "$1" in */Door*) steps=1800 ;; esac
    demonstrate "$1"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" policies finetune "$FOLDER/demonstrations/$name/$name" --base zoo:base \
            --out "$FOLDER/experts/$name" --steps "$(few $steps)" --learning-rate 1e-3 --shift 2 --action-steps 4
}
export -f demonstrate expert
export FOLDER ROBOGAUNTLET
printf '%s\n' $TASKS | xargs -P 2 -I TASK bash -euo pipefail -c 'expert "$1"' expert TASK
# Routers of merges with experts of the zoo are fitted to these.
printf '%s\n' $OF_THE_ZOO | xargs -P 2 -I TASK bash -euo pipefail -c 'demonstrate "$1"' demonstrate TASK
