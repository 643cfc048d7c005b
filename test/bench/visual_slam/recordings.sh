#!/usr/bin/env bash
# slam_trials over the shared recordings and the virtual stomachs, each with its own depth and,
# where there is one, with the true depth; many start frames, both directions, beside OpenCV.
# usage: recordings.sh BIN_FOLDER [STARTS]
set -euo pipefail
cd "$(dirname "$0")/../../.."
bin=$1
starts=${2:-6}
data=${GASTRONAUT_DATA:-../shared/data}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Shows what a program says only when it fails.
quietly() { "$@" >"$work/messages" 2>&1 || { cat "$work/messages" >&2 && return 1; }; }

# trials NAME RAW_LOG DEPTHS... -- OPTIONS...
trials() {
  local name=$1 raw=$2 depths=()
  shift 2
  while [[ $1 != -- ]]; do
    depths+=("$1")
    shift
  done
  shift
  quietly "$bin/replay" "$raw" --only depth_estimator --keep-images --out "$work/derived.lcmlog"
  for depth in "${depths[@]}"; do
    printf '\n-- %s, %s depth\n' "$name" "$depth"
    "$bin/slam_trials" "$work/derived.lcmlog" --depth "$depth" --starts "$starts" --peer "$@" \
      2>"$work/messages" || cat "$work/messages" >&2
  done
  rm -f "$work"/*.lcmlog*
}

if [[ -d $data ]]; then
  for phantom in phantom_a phantom_c; do
    quietly "$bin/import" capture "$data/$phantom" --out "$work/raw.lcmlog"
    trials "$phantom" "$work/raw.lcmlog" own truth --
  done
  test/bench/visual_slam/livingroom_as_tum.py "$data/livingroom" "$work/livingroom"
  quietly "$bin/import" tum "$work/livingroom" --camera config/cameras/livingroom.yaml \
    --depth-relative-std 0.001 --out "$work/raw.lcmlog"
  trials livingroom "$work/raw.lcmlog" own -- --rpe-path 100mm --least 20
  quietly "$bin/import" tum "$data/tum_fr1_rpy_60" --camera config/cameras/tum_freiburg1.yaml \
    --out "$work/raw.lcmlog"
  trials tum_fr1_rpy_60 "$work/raw.lcmlog" own -- --rpe-path 100mm --least 20
else
  echo "no recordings in $data: set GASTRONAUT_DATA to the shared data's folder"
fi

for stomach in st0 st1 st2 st3; do
  quietly "$bin/virtual_rig" --scenario "config/scenarios/$stomach.yaml" --duration 20 \
    --set camera_file=../cameras/capsule_320x240.yaml --set rig.camera.rate=10 \
    --log-out "$work/raw.lcmlog"
  trials "$stomach" "$work/raw.lcmlog" own truth --
done
