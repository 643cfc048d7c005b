#!/usr/bin/env bash
# The separate live processes at the pace of the rig: how long after a measurement its CAPSULE_STATE
# comes. Plays RAW_LOG, or makes one: the virtual stomach at RATE pictures a second.
# usage: live_latency.sh BIN_FOLDER [RATE [CAMERA [RAW_LOG]]]
set -euo pipefail
cd "$(dirname "$0")/../../.."
bin=$1 rate=${2:-30} camera=${3:-capsule_320x240} raw=${4:-}
url="udpm://239.255.76.67:7667?ttl=0&recv_buf_size=33554432"
processes=(magnetic_localizer depth_estimator visual_slam sensor_fusion)

if [[ ${IN_NAMESPACE:-} != yes ]]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  if [[ -z $raw ]]; then
    raw=$work/raw.lcmlog
    "$bin/virtual_rig" --scenario config/scenarios/st0.yaml --log-out "$raw" \
      --set camera_file="../cameras/$camera.yaml" --set "rig.camera.rate=$rate Hz" \
      2>"$work/messages" || { cat "$work/messages" >&2 && exit 1; }
  fi
  "$bin/print_rig_config" "$raw" >"$work/rig.yaml"
  IN_NAMESPACE=yes WORK=$work test/system/in_network_namespace "$0" "$bin" "$rate" "$camera" "$raw"
  "$bin/live_latency" "$work/live.lcmlog"
  exit
fi

lcm-logger --lcm-url="$url" --quiet "$WORK/live.lcmlog" &
running=($!)
for process in "${processes[@]}"; do
  "$bin/$process" --config "$WORK/rig.yaml" --lcm-url "$url" 2>"$WORK/$process.messages" &
  running+=($!)
done
trap 'kill -INT "${running[@]}" 2>/dev/null || true; wait' EXIT
sleep 2
lcm-logplayer --lcm-url="$url" "$raw" >/dev/null
sleep 1
