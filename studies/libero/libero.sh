#!/usr/bin/env bash
# The zoo's experts of LIBERO, one per suite, on its base, which has seen none of it: demonstrations of six tasks each, the
# first that oracles solve in at least 45 of their 50 stored states, and an expert; then the four merged, and a control.
# Finished parts are skipped and stopped ones continue, so the same command goes on after any interruption.
# `LIBERO=FOLDER python -m studies libero --measure libero_experts` and `libero_merges` play what the zoo has of it.
# Usage: studies/libero/libero.sh [FOLDER] [SUITE...]   (default runs/libero and all four). Takes about two hours on two cores, after
# `robogauntlet env create libero`.
# PERCENT=1 makes the same in minutes from a hundredth of everything: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=${1:-runs/libero${PERCENT:+-$PERCENT-percent}}
shift || true
ALL="goal object spatial 10"
SUITES=${*:-$ALL}
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
export OMP_NUM_THREADS=1

# Of a share of everything the first task alone, which is then measured.
tasks_of() {
    local numbers
    case $1 in
    spatial) numbers="0 1 2 3 5 6" ;; object) numbers="0 1 2 3 4 5" ;; goal) numbers="1 2 4 6 7 8" ;; 10) numbers="0 1 2 3 4 6" ;;
    *) echo "SUITE: expected spatial, object, goal or 10, got '$1'" >&2; return 2 ;;
    esac
    if [ "${PERCENT:-100}" -ge 100 ]; then echo "$numbers"; else echo "${numbers%% *}"; fi
}

# `demonstrations` and `experts` of a suite, and `replays`: an episode of each task without noise, to be played open loop.
expert() {
    local number out="$FOLDER/experts/libero-$1"
    # One task after the other, since one process at a time records into a folder.
    for number in $(tasks_of "$1"); do
        "$ROBOGAUNTLET" new demonstrations "libero/$1-$number-*" --out "$FOLDER/demonstrations/$1" \
            --episodes "$(few 50)" --render-profile fast-2 --workers 1
        "$ROBOGAUNTLET" new demonstrations "libero/$1-$number-*" --out "$FOLDER/replays/$1" --episodes 1 --noise 0 \
            --render-profile fast-2 --workers 1
    done
    [ -e "$out/card.json" ] || finetune "$FOLDER/demonstrations/$1" zoo:base "$out"
}

# Control: Goal's expert on a base with random weights. The base's one step is too small to change them.
control() {
    local data="$FOLDER/demonstrations/goal" out="$FOLDER/random"
    [ -e "$out/base/card.json" ] ||
        "$ROBOGAUNTLET" mergevla pretrain "$data" --out "$out/base" --steps 1 --learning-rate 1e-9
    [ -e "$out/libero-goal/card.json" ] || finetune "$data" "$out/base" "$out/libero-goal"
}

finetune() {
    "$ROBOGAUNTLET" mergevla finetune "$1" --base "$2" --out "$3" --steps "$(few 6000)" --learning-rate 1e-3 --shift 2 \
        --action-steps 4 --adapt-convolutions --bfloat16
}
export -f expert finetune tasks_of
export FOLDER ROBOGAUNTLET
for suite in $SUITES; do tasks_of "$suite" >/dev/null; done
# shellcheck disable=SC2086  # suites are several words
printf '%s\n' $SUITES | xargs -P 2 -I SUITE bash -euo pipefail -c 'expert "$1"' expert SUITE
[ "$SUITES" = "$ALL" ] || exit 0
control
[ -e "$FOLDER/merged/card.json" ] ||
    "$ROBOGAUNTLET" mergevla merge "$FOLDER/experts" --out "$FOLDER/merged" --operator magnitude --rounds 2 --no-weights \
        --demonstrations "$FOLDER"/demonstrations/goal --demonstrations "$FOLDER"/demonstrations/object \
        --demonstrations "$FOLDER"/demonstrations/spatial --demonstrations "$FOLDER"/demonstrations/10 \
        --router calibrated --router nearest-centroid
