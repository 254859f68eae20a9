#!/usr/bin/env bash
# Experts of scenes that vary along ten axes, with words that are changed in training, and their merges, beside the zoo's
# under all axes: demonstrations, experts from the zoo's base, two merged models, two runs. Finished parts are skipped and
# stopped ones continue, so the same command goes on after any interruption.
# Usage: scripts/robust_experts.sh [FOLDER]   (default runs/robust-experts). Takes some three hours on two cores.
# PERCENT=2 AXES=table does the same in minutes from a fiftieth of everything, along one axis: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=$(realpath -m "${1:-runs/robust-experts${PERCENT:+-$PERCENT-percent}}")  # the suite names checkpoints by it
DATA="$FOLDER/demonstrations"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task, demonstrations, steps of its expert's training, further options: the longest first, so that both processes end
# together. PandaReach's goal is a point in the air, which two moved cameras have to locate.
EXPERTS="pybullet/PandaReach-v3 1800 8000 --adapt-convolutions
pybullet/PandaPickAndPlace-v3 400 5000
robosuite/Door 300 3000
robosuite/Lift 300 2500
maniskill/PushCube-v1 300 2500
maniskill/PullCube-v1 300 2500"
VARIED="camera-orbit@3 camera-distance@3 field-of-view@3 light-direction@3 illuminance@3 colour-temperature@3 table@3
distractors@3 object-position@2 robot-start@2"
export OMP_NUM_THREADS=1 FOLDER DATA ROBOGAUNTLET

vary=()
for axis in $VARIED; do vary+=(--vary "$axis"); done
tasks=()
while read -r task demonstrations _; do
    "$ROBOGAUNTLET" policies demonstrate "$task" --out "$DATA" --episodes "$(few "$demonstrations")" --workers 2 \
        --first-seed 3000000 "${vary[@]}" </dev/null
    tasks+=("$task")
done <<<"$EXPERTS"

expert() {
    local name="${1/\//__}"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" policies finetune "$DATA/$name" --base zoo:base --out "$FOLDER/experts/$name" \
            --steps "$(few "$3")" --learning-rate 1e-3 --shift 2 --action-steps 4 --change-words 0.3 "${@:4}"
}
export -f expert
xargs -P 2 -L 1 bash -c 'expert "$@"' expert <<<"$EXPERTS"

merge() {
    [ -e "$FOLDER/$1/card.json" ] ||
        "$ROBOGAUNTLET" policies merge "$FOLDER/experts" --out "$FOLDER/$1" --demonstrations "$DATA" \
            --router calibrated "${@:2}"
}
merge merged --operator magnitude --keep-blocks 1 --rounds 2
merge unmerged-int4 --operator none --masks none --bits 4

AXES=${AXES:-"camera-orbit camera-distance field-of-view camera-bump illuminance light-direction colour-temperature table distractors
object-position robot-start dynamics noise blur frozen-frames action-noise action-delay instruction"}
# The run of a family on some tasks: its experts, what is merged from them, and themselves with four bits per weight.
play() {
    cat >"$FOLDER/$1.yaml" <<END
name: $1
policies:
  - oracle
  - {name: experts, kind: mergevla-experts, options: {folder: "${2}experts"}}
  - {name: merged, kind: mergevla-merged, options: {checkpoint: "${2}merged"}}
  - {name: unmerged-int4, kind: mergevla-merged, options: {checkpoint: "${2}unmerged-int4"}}
tasks: [$(IFS=,; echo "${*:3}")]
conditions:
  - clean
$(for axis in $AXES; do echo "  - {axis: $axis, severities: [2, 4]}"; done)
compare: {baseline: experts, others: [merged, unmerged-int4], margin: 0.05}
oracle_gate: oracle
seeds: {count: $(few 4)}
image_size: 96
render_profile: fast-2
END
    "$ROBOGAUNTLET" run "$FOLDER/$1.yaml" --out "$FOLDER/runs/$1" --no-media
}
play robust "$FOLDER/" "${tasks[@]}"
play zoo zoo: "${tasks[@]}" maniskill/StackCube-v1 pybullet/PandaPush-v3 robosuite/Stack
