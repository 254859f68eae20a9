#!/usr/bin/env bash
# Experts of the SO-101's three tasks from fifty demonstrations each, as in MergeVLA's fourth table: demonstrations, a
# base of the three tasks, the experts. Finished parts are skipped and stopped ones continue, so the same command goes on
# after any interruption. `SO101=FOLDER python -m studies so101 --measure so101` merges and plays them.
# Usage: studies/so101/so101.sh [FOLDER]   (default runs/so101). Takes three quarters of an hour on two cores.
# PERCENT=1 makes the same in a minute from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/so101${PERCENT:+-$PERCENT-percent}}
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
TASKS="so101/PickPlace so101/Push so101/Stack"
export OMP_NUM_THREADS=1 FOLDER ROBOGAUNTLET

# shellcheck disable=SC2086  # tasks are several words
"$ROBOGAUNTLET" new demonstrations $TASKS --out "$FOLDER/demonstrations" --episodes "$(few 50)" \
    --render-profile fast-2 --workers 2
[ -e "$FOLDER/base/card.json" ] ||
    OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE "$ROBOGAUNTLET" mergevla pretrain "$FOLDER/demonstrations" \
        --out "$FOLDER/base" --steps "$(few 2500)" --batch-size 64 --learning-rate 1.5e-3 --shift 2 --threads 2 \
        --action-steps 4

expert() {
    local name="${1/\//__}"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "$FOLDER/demonstrations/$name" --base "$FOLDER/base" \
            --out "$FOLDER/experts/$name" --steps "$2" --learning-rate 1e-3 --shift 2 --action-steps 4
}
export -f expert
for task in $TASKS; do echo "$task $(few 2000)"; done | xargs -P 2 -L 1 bash -c 'expert "$@"' expert
