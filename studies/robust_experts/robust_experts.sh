#!/usr/bin/env bash
# Experts of scenes that vary along ten axes, with words that are changed in training, and their merges, beside the zoo's
# under all axes: demonstrations, experts from the zoo's base, two merged models, two runs. Then experts of three further
# tasks beside plain ones of an equal budget. Finished parts are skipped and stopped ones continue, so the same command
# goes on after any interruption.
# Usage: studies/robust_experts/robust_experts.sh [FOLDER]   (default runs/robust-experts). Takes some eight hours on two cores.
# PERCENT=2 AXES=table does the same in minutes from a fiftieth of everything, along one axis: see scripts/percent.sh.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/percent.sh
FOLDER=$(realpath -m "${1:-runs/robust-experts${PERCENT:+-$PERCENT-percent}}")  # the suite names checkpoints by it
DATA="$FOLDER/varied/demonstrations"
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
# Task, demonstrations, steps of its expert's training, further options: the longest first, so that both processes end
# together. PandaReach's goal is a point in the air, which two moved cameras have to locate.
EXPERTS="pybullet/PandaReach-v3 1800 8000 --adapt-convolutions --action-steps 4
pybullet/PandaPickAndPlace-v3 400 5000 --action-steps 4
robosuite/Door 300 3000 --action-steps 4
robosuite/Lift 300 2500 --action-steps 4
maniskill/PushCube-v1 300 2500 --action-steps 4
maniskill/PullCube-v1 300 2500 --action-steps 4"
# Three further tasks, each with a plain expert and one of varied scenes.
CORRECTED=pybullet/PandaPush-v3
EQUAL_BUDGET="robosuite/Stack 700 14000 --adapt-convolutions --action-steps 8
maniskill/StackCube-v1 500 12000 --adapt-convolutions --action-steps 2
$CORRECTED 500 9000 --adapt-convolutions --action-steps 4"
VARIED="camera-orbit@3 camera-distance@3 field-of-view@3 light-direction@3 illuminance@3 colour-temperature@3 table@3
distractors@3 object-position@2 robot-start@2"
export OMP_NUM_THREADS=1 FOLDER ROBOGAUNTLET CORRECTED

vary=()
for axis in $VARIED; do vary+=(--vary "$axis"); done
# Kind of scenes, first seed, tasks, options.
demonstrate() {
    while read -r task demonstrations _; do
        "$ROBOGAUNTLET" new demonstrations "$task" --workers 2 --out "$FOLDER/$1/demonstrations" \
            --episodes "$(few "$demonstrations")" --first-seed "$2" "${@:4}" </dev/null
    done <<<"$3"
    # As in the zoo, one task's expert learns from being corrected as well: the zoo's expert acts, the oracle takes over.
    "$ROBOGAUNTLET" new demonstrations "$CORRECTED" --workers 2 --out "$FOLDER/$1/corrections" \
        --episodes "$(few 300)" --first-seed "$(($2 + 500000))" --learner zoo:experts --whole "${@:4}"
}
demonstrate plain 1000000 "$EQUAL_BUDGET"
demonstrate varied 3000000 "$EQUAL_BUDGET
$EXPERTS" "${vary[@]}"

# Folder of the experts, kind of scenes, task, demonstrations, steps, further options.
expert() {
    local name="${3/\//__}" words=()
    local data=("$FOLDER/$2/demonstrations/$name")
    [ "$3" != "$CORRECTED" ] || data+=("$FOLDER/$2/corrections/$name")
    [ "$2" = plain ] || words=(--change-words 0.3)
    [ -e "$FOLDER/$1/$name/card.json" ] ||
        "$ROBOGAUNTLET" mergevla finetune "${data[@]}" --base zoo:base --out "$FOLDER/$1/$name" \
            --steps "$(few "$5")" --learning-rate 1e-3 --shift 2 "${words[@]}" "${@:6}"
}
export -f expert
# shellcheck disable=SC2001  # each line gets the folder and the kind of scenes
{
    sed "s|^|plain/experts plain |" <<<"$EQUAL_BUDGET"
    sed "s/^/equal-budget varied /" <<<"$EQUAL_BUDGET"
    sed "s/^/experts varied /" <<<"$EXPERTS"
} | xargs -P 2 -L 1 bash -c 'expert "$@"' expert

merge() {
    [ -e "$FOLDER/$1/card.json" ] ||
        "$ROBOGAUNTLET" mergevla merge "$FOLDER/experts" --out "$FOLDER/$1" --demonstrations "$DATA" \
            --router calibrated "${@:2}"
}
merge merged --operator magnitude --keep-blocks 1 --rounds 2
merge unmerged-int4 --operator none --masks none --bits 4

AXES=${AXES:-"camera-orbit camera-distance field-of-view camera-bump illuminance light-direction colour-temperature table distractors
object-position robot-start dynamics noise blur frozen-frames action-noise action-delay instruction"}
# Name of a run, its tasks, policies and comparison.
play() {
    cat >"$FOLDER/$1.yaml" <<END
name: $1
tasks: [$(cut -d ' ' -f 1 <<<"$2" | paste -s -d ,)]
policies:
  - oracle
$3
compare: $4
conditions:
  - clean
$(for axis in $AXES; do echo "  - {axis: $axis, severities: [2, 4]}"; done)
oracle_gate: oracle
seeds: {count: $(few 4)}
image_size: 96
render_profile: fast-2
END
    "$ROBOGAUNTLET" run "$FOLDER/$1.yaml" --out "$FOLDER/runs/$1" --no-media
}
# A family's experts, what is merged from them, and themselves with four bits per weight.
family() {
    play "$1" "$3" "  - {name: experts, kind: mergevla-experts, options: {folder: '${2}experts'}}
  - {name: merged, kind: mergevla-merged, options: {checkpoint: '${2}merged'}}
  - {name: unmerged-int4, kind: mergevla-merged, options: {checkpoint: '${2}unmerged-int4'}}" \
        "{baseline: experts, others: [merged, unmerged-int4], margin: 0.05}"
}
family robust "$FOLDER/" "$EXPERTS"
family zoo zoo: "$EXPERTS
$EQUAL_BUDGET"
play equal-budget "$EQUAL_BUDGET" "  - {name: plain, kind: mergevla-experts, options: {folder: '$FOLDER/plain/experts'}}
  - {name: robust, kind: mergevla-experts, options: {folder: '$FOLDER/equal-budget'}}" \
    "{baseline: plain, others: [robust]}"
