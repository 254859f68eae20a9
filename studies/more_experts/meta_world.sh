#!/usr/bin/env bash
# Experts of Meta-World on the zoo's base, which has seen none of it: demonstrations and an expert of each task. The
# twenty tasks are those with the shortest horizons, the shortest first. Finished parts are skipped and stopped ones
# continue, so the same command goes on after any interruption. `META_WORLD=FOLDER python -m studies more_experts
# --measure more_experts` merges and plays them.
# Usage: studies/more_experts/meta_world.sh [FOLDER] [TASK...]   (default runs/meta-world and the tasks below). Takes an hour on two
# cores.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/meta-world${PERCENT:+-$PERCENT-percent}}
shift || true
TASKS=${*:-coffee-button handle-press handle-press-side plate-slide-back-side plate-slide-side plate-slide reach-wall
    coffee-push pick-place button-press-topdown-wall button-press faucet-close faucet-open hand-insert reach sweep-into
    button-press-topdown button-press-wall door-close push}
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
export OMP_NUM_THREADS=1

# A folder for each task, since one process at a time records into one.
expert() {
    local name="metaworld__$1-v3"
    "$ROBOGAUNTLET" new demonstrations "metaworld/$1-v3" --out "$FOLDER/demonstrations/$name" \
        --episodes "$(few 150)" --render-profile fast-2 --workers 1
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "$FOLDER/demonstrations/$name/$name" --base zoo:base \
            --out "$FOLDER/experts/$name" --steps "$(few 1000)" --learning-rate 1e-3 --shift 2 --action-steps 4
}
export -f expert
export FOLDER ROBOGAUNTLET
# shellcheck disable=SC2086  # tasks are several words
printf '%s\n' $TASKS | xargs -P 2 -I TASK bash -euo pipefail -c 'expert "$1"' expert TASK
