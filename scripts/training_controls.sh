#!/usr/bin/env bash
# The controls that take training: blocks and gates apart, joint training with an equal budget, variance over training
# seeds. For each seed and each kind of block: a base on five tasks, five experts, three merges; then all of them play
# the same episodes. Smaller than the zoo, so that many trainings fit: five tasks, 150 demonstrations each.
# Finished parts are skipped and stopped ones continue, so the same command goes on after any interruption.
# Usage: scripts/training_controls.sh [FOLDER] [SEED...]   (default runs/training-controls 0 1 2). Takes hours.
# PERCENT=2 does the same in minutes from a fiftieth of everything: see percent.sh.
# DEMONSTRATIONS: folder with demonstrations to use as they are, for instance those of scripts/zoo.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=$(realpath -m "${1:-runs/training-controls${PERCENT:+-$PERCENT-percent}}")  # suites name checkpoints by it
shift || true
SEEDS=${*:-0 1 2}
DATA=$(realpath -m "${DEMONSTRATIONS:-$FOLDER/demonstrations}")
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
TASKS="maniskill/PushCube-v1 maniskill/PullCube-v1 pybullet/PandaReach-v3 robosuite/Lift robosuite/Door"
BASE_STEPS=$(few 1000)
EXPERT_STEPS=$(few 1000)
# As many frames as a base (64 a step) and five experts (32 a step) see together.
JOINT_STEPS=$((BASE_STEPS + 5 * EXPERT_STEPS / 2))
EPISODES=$(few 20)
export OMP_NUM_THREADS=1

# shellcheck disable=SC2086  # tasks are several words
[ -n "${DEMONSTRATIONS:-}" ] || "$ROBOGAUNTLET" policies demonstrate $TASKS --out "$DATA" --episodes "$(few 150)" --workers 2

datasets() {
    for task in $TASKS; do echo "$DATA/${task/\//__}"; done
}

# Folder of the checkpoint, what makes it: done once.
once() {
    local out="$1"
    shift
    [ -e "$out/card.json" ] || "$ROBOGAUNTLET" policies "$@" --out "$out"
}

base() {
    local out="$1" seed="$2" steps="$3"
    shift 3
    # shellcheck disable=SC2046
    once "$out" pretrain $(datasets) --steps "$steps" --seed "$seed" --batch-size 64 --learning-rate 1.5e-3 \
        --shift 2 --action-steps 4 "$@"
}

# Name of the blocks, training seed.
train() {
    local blocks="$1" seed="$2" out="$FOLDER/$1-$2" options=()
    case "$blocks" in
    cross-sigmoid) ;;
    cross-tanh) options=(--size tiny-tanh) ;;
    self-sigmoid) options=(--size tiny-self-attention-sigmoid) ;;
    self-tanh) options=(--size tiny-self-attention) ;;
    joint)
        base "$out/base" "$seed" "$JOINT_STEPS"
        return
        ;;
    esac
    base "$out/base" "$seed" "$BASE_STEPS" ${options[@]+"${options[@]}"}
    for task in $TASKS; do
        once "$out/experts/${task/\//__}" finetune "$DATA/${task/\//__}" --base "$out/base" --steps "$EXPERT_STEPS" \
            --seed "$seed" --learning-rate 1e-3 --shift 2 --action-steps 4
    done
    once "$out/paper" merge "$out/experts" --operator ta --trunk mean
    once "$out/ta-s" merge "$out/experts" --operator ta
    once "$out/signs" merge "$out/experts" --operator magnitude
}
export -f train base once datasets
export FOLDER DATA ROBOGAUNTLET TASKS BASE_STEPS EXPERT_STEPS JOINT_STEPS

for seed in $SEEDS; do
    for blocks in cross-sigmoid self-tanh cross-tanh self-sigmoid joint; do echo "$blocks $seed"; done
done | xargs -P 2 -L 1 bash -euo pipefail -c 'train "$@"' train

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

for seed in $SEEDS; do
    for blocks in cross-sigmoid cross-tanh self-sigmoid self-tanh; do
        of="$FOLDER/$blocks-$seed"
        echo "  - {name: $blocks-experts-$seed, kind: mergevla-experts, options: {folder: \"$of/experts\"}}"
        for way in paper ta-s signs; do
            echo "  - {name: $blocks-$way-$seed, kind: mergevla-merged, options: {checkpoint: \"$of/$way\", router: oracle}}"
        done
    done | play "blocks-$seed"
    echo "  - {name: joint-$seed, kind: mergevla, options: {checkpoint: \"$FOLDER/joint-$seed/base\"}}" | play "joint-$seed"
done
TRAINING_CONTROLS="$FOLDER" "$(dirname "$ROBOGAUNTLET")/python" -m tests.benchmarks training_controls
