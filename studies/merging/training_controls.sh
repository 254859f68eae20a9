#!/usr/bin/env bash
# The controls that take training: blocks and gates apart, joint training with an equal budget, trunks of independent
# initialisation, a base of other tasks, variance over training seeds. For each seed and each kind: a base, experts of
# five tasks, three merges; then all of them play the same episodes. Smaller than the zoo, so that many trainings fit:
# five tasks, 150 demonstrations each.
#   cross-sigmoid  MergeVLA's blocks, a base of the five tasks; cross-tanh, self-sigmoid, self-tanh: other blocks
#   quirks         the errors of the paper's released code, a base of the five tasks
#   other          a base of four other tasks
#   matched        a base of their images and sentences, without actions
#   KIND-fresh     the same base, each expert's trunk from a seed of its own, as in arXiv 2511.18810
#   joint          one network on all five tasks, with as many frames as a base and its experts
# Finished parts are skipped and stopped ones continue, so the same command goes on after any interruption.
# Usage: studies/merging/training_controls.sh [FOLDER] [SEED...]   (default runs/training-controls 0 1 2). Takes hours.
# PERCENT=2 does the same in minutes from a fiftieth of everything: see scripts/percent.sh.
# KINDS: those to train and play, by default all.
# DEMONSTRATIONS: folder with demonstrations to use as they are, for instance those of scripts/zoo.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=$(realpath -m "${1:-runs/training-controls${PERCENT:+-$PERCENT-percent}}")  # suites name checkpoints by it
shift || true
SEEDS=${*:-0 1 2}
KINDS=${KINDS:-cross-sigmoid self-tanh cross-tanh self-sigmoid quirks joint cross-sigmoid-fresh self-tanh-fresh other other-fresh matched matched-fresh}
DATA=$(realpath -m "${DEMONSTRATIONS:-$FOLDER/demonstrations}")
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
TASKS="maniskill/PushCube-v1 maniskill/PullCube-v1 pybullet/PandaReach-v3 robosuite/Lift robosuite/Door"
OTHER_TASKS="maniskill/StackCube-v1 pybullet/PandaPush-v3 pybullet/PandaPickAndPlace-v3 robosuite/Stack"
BASE_STEPS=$(few 1000)
EXPERT_STEPS=$(few 1000)
# As many frames as a base (64 a step) and five experts (32 a step) see together.
JOINT_STEPS=$((BASE_STEPS + 5 * EXPERT_STEPS / 2))
EPISODES=$(few 20)
export OMP_NUM_THREADS=1

# shellcheck disable=SC2086  # tasks are several words
[ -n "${DEMONSTRATIONS:-}" ] || "$ROBOGAUNTLET" new demonstrations $TASKS $OTHER_TASKS --out "$DATA" --episodes "$(few 150)" --workers 2

datasets() {
    for task in "$@"; do echo "$DATA/${task/\//__}"; done
}

# Folder of the checkpoint, what makes it: done once.
once() {
    local out="$1"
    shift
    [ -e "$out/card.json" ] || "$ROBOGAUNTLET" mergevla "$@" --out "$out"
}

# Kind without -fresh, training seed.
base() {
    local kind="$1" seed="$2" tasks="$TASKS" steps="$BASE_STEPS" options=()
    case "$kind" in
    cross-tanh) options=(--size tiny-tanh) ;;
    self-sigmoid) options=(--size tiny-self-attention-sigmoid) ;;
    self-tanh) options=(--size tiny-self-attention) ;;
    quirks) options=(--size tiny-quirks) ;;
    other) tasks="$OTHER_TASKS" ;;
    matched) tasks="$OTHER_TASKS" options=(--without-actions) ;;
    joint) steps="$JOINT_STEPS" ;;
    esac
    # shellcheck disable=SC2046,SC2086
    once "$FOLDER/$kind-$seed/base" pretrain $(datasets $tasks) --steps "$steps" --seed "$seed" --batch-size 64 \
        --learning-rate 1.5e-3 --shift 2 --action-steps 4 ${options[@]+"${options[@]}"}
}

# Kind, training seed.
experts() {
    local kind="$1" seed="$2" out="$FOLDER/$1-$2" number=0 trunk=()
    for task in $TASKS; do
        number=$((number + 1))
        case "$kind" in *-fresh) trunk=(--fresh-trunk $((100 * (seed + 1) + number))) ;; esac
        once "$out/experts/${task/\//__}" finetune "$DATA/${task/\//__}" --base "$FOLDER/${kind%-fresh}-$seed/base" \
            --steps "$EXPERT_STEPS" --seed "$seed" --learning-rate 1e-3 --shift 2 --action-steps 4 \
            ${trunk[@]+"${trunk[@]}"}
    done
    once "$out/paper" merge "$out/experts" --operator ta --trunk mean
    once "$out/ta-s" merge "$out/experts" --operator ta
    once "$out/signs" merge "$out/experts" --operator magnitude
}
export -f experts base once datasets
export FOLDER DATA ROBOGAUNTLET TASKS OTHER_TASKS BASE_STEPS EXPERT_STEPS JOINT_STEPS

# What is done ("base" or "experts"); reads kinds, a line each. Two at once.
each_seed() {
    while read -r kind; do
        for seed in $SEEDS; do echo "$kind $seed"; done
    done | xargs -P 2 -L 1 bash -euo pipefail -c "$1"' "$@"' "$1"
}
printf '%s\n' $KINDS | sed 's/-fresh$//' | sort -u | each_seed base
printf '%s\n' $KINDS | sed '/^joint$/d' | each_seed experts

# Name of the suite; reads its policies, a line each.
play() {
    local suite="$FOLDER/$1.yaml"
    {
        echo "name: training-controls-$1"
        echo "policies:"
        cat
        echo "tasks: [$(tr ' ' ',' <<<"$TASKS")]"
        echo "seeds: {start: 0, count: $EPISODES}"
        echo "image_size: 96"
        echo "render_profile: fast"
        echo "workers: auto"
    } >"$suite"
    "$ROBOGAUNTLET" run "$suite" --out "$FOLDER/run-$1" --no-media
}

# A suite for each kind and seed, so that more kinds can be added.
for seed in $SEEDS; do
    for kind in $KINDS; do
        of="$FOLDER/$kind-$seed"
        if [ "$kind" = joint ]; then
            echo "  - {name: joint-$seed, kind: mergevla, options: {checkpoint: \"$of/base\"}}"
        else
            echo "  - {name: $kind-experts-$seed, kind: mergevla-experts, options: {folder: \"$of/experts\"}}"
            for way in paper ta-s signs; do
                echo "  - {name: $kind-$way-$seed, kind: mergevla-merged, options: {checkpoint: \"$of/$way\", router: oracle}}"
            done
        fi | play "$kind-$seed"
    done
done
TRAINING_CONTROLS="$FOLDER" "$(dirname "$ROBOGAUNTLET")/python" -m studies merging --measure training_controls
