#!/usr/bin/env bash
# Experts of other arms of robosuite, on the zoo's base: demonstrations and an expert of each task, as scripts/zoo.sh
# makes those of the Panda. Finished parts are skipped and stopped ones continue, so the same command goes on after any
# interruption. `ARMS=FOLDER python -m studies arms --measure arms` merges and plays them, `doors` plays those of DOORS, which
# have twice the demonstrations and steps.
# Usage: studies/arms/arms.sh [FOLDER] [TASK...]   (default runs/arms, the tasks below and DOORS). Takes three hours on two cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/arms${PERCENT:+-$PERCENT-percent}}
shift || true
DOORS=
[ $# -gt 0 ] || DOORS="robosuite/Door@Kinova3 robosuite/Door@UR5e robosuite/Door@IIWA robosuite/Door@Jaco robosuite/Door@XArm7"
TASKS=${*:-robosuite/Door@Kinova3 robosuite/Lift@UR5e robosuite/Lift@Kinova3 robosuite/Lift@IIWA robosuite/Lift@Jaco robosuite/Lift@XArm7}
OF_THE_ZOO="robosuite/Stack robosuite/Lift"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
export OMP_NUM_THREADS=1

# A folder for each task, since one process at a time records into one.
# Task, and by default 150 episodes in demonstrations/.
demonstrate() {
    "$ROBOGAUNTLET" new demonstrations "$1" --out "$FOLDER/${3:-demonstrations}/${1/\//__}" \
        --episodes "$(few "${2:-150}")" --render-profile fast-2 --workers 1
}

# Folders of the expert and of its demonstrations, task, steps.
train() {
    local name="${3/\//__}"
    [ -e "$FOLDER/$1/$name/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "$FOLDER/$2/$name/$name" --base zoo:base --out "$FOLDER/$1/$name" \
            --steps "$(few "$4")" --learning-rate 1e-3 --shift 2 --action-steps 4
}

# As many steps as the zoo's experts of the same tasks have.
expert() {
    local steps=1500
    case "$1" in */Door*) steps=1800 ;; esac
    demonstrate "$1"
    train experts demonstrations "$1" $steps
}
door() {
    demonstrate "$1" 300 door-demonstrations
    train doors door-demonstrations "$1" 3600
}
export -f demonstrate train expert door
export FOLDER ROBOGAUNTLET
printf '%s\n' $TASKS | xargs -P 2 -I TASK bash -euo pipefail -c 'expert "$1"' expert TASK
# Routers of merges with experts of the zoo are fitted to these.
printf '%s\n' $OF_THE_ZOO | xargs -P 2 -I TASK bash -euo pipefail -c 'demonstrate "$1"' demonstrate TASK
printf '%s\n' $DOORS | xargs -r -P 2 -I TASK bash -euo pipefail -c 'door "$1"' door TASK
