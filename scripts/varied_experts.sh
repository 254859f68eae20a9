#!/usr/bin/env bash
# What demonstrations in varied scenes bring: one expert per task from the zoo's base, trained as the zoo's but in scenes
# that vary along ten axes, beside the zoo's expert under seventeen axes at severity 2. Steps that are done are skipped.
# Usage: scripts/varied_experts.sh [FOLDER]   (default runs/varied-experts). About an hour on two cores.
# PERCENT=2 does the same in minutes from a fiftieth of everything: see percent.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/percent.sh
FOLDER=$(realpath -m "${1:-runs/varied-experts${PERCENT:+-$PERCENT-percent}}")  # the suite names checkpoints by it
ROBOGAUNTLET=${ROBOGAUNTLET:-.venv/bin/robogauntlet}
TASKS=${TASKS:-maniskill/PushCube-v1 pybullet/PandaReach-v3 robosuite/Lift}
VARIED="camera-orbit@3 camera-distance@3 field-of-view@3 light-direction@3 illuminance@3 colour-temperature@3 table@3
distractors@3 object-position@2 robot-start@2"
EPISODES=$(few 10)
export OMP_NUM_THREADS=1 FOLDER ROBOGAUNTLET

vary=()
for axis in $VARIED; do vary+=(--vary "$axis"); done
# shellcheck disable=SC2086  # tasks are several words
"$ROBOGAUNTLET" policies demonstrate $TASKS --out "$FOLDER/demonstrations" --episodes "$(few 200)" --workers 2 \
    --first-seed 3000000 "${vary[@]}"

expert() {
    local name="${1/\//__}"
    [ -e "$FOLDER/experts/$name/card.json" ] ||
        "$ROBOGAUNTLET" policies finetune "$FOLDER/demonstrations/$name" --base zoo:base --out "$FOLDER/experts/$name" \
            --steps "$2" --learning-rate 1e-3 --shift 2 --action-steps 4
}
export -f expert
for task in $TASKS; do echo "$task $(few 2500)"; done | xargs -P 2 -L 1 bash -c 'expert "$@"' expert

cat >"$FOLDER/suite.yaml" <<END
name: varied-experts
policies:
  - oracle
  - {name: experts, kind: mergevla-experts, options: {folder: "zoo:experts"}}
  - {name: varied, kind: mergevla-experts, options: {folder: "$FOLDER/experts"}}
tasks: [${TASKS// /, }]
conditions: [clean]
design:
  kind: one-at-a-time
  axes: [camera-orbit, camera-distance, field-of-view, camera-bump, light-direction, illuminance, colour-temperature, table,
    distractors, object-position, robot-start, noise, blur, frozen-frames, action-noise, action-delay, instruction]
  severities: [2]
compare: {baseline: experts, others: [varied]}
oracle_gate: oracle
seeds: {count: $EPISODES}
image_size: 96
render_profile: fast
END
"$ROBOGAUNTLET" run "$FOLDER/suite.yaml" --out "$FOLDER/run" --no-media
