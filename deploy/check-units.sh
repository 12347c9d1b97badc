#!/bin/sh
# Exposure of the systemd units, measured without a running systemd: at most 1.8 of 10 each (--threshold is in tenths).
set -eu
cd "$(dirname "$0")"
if ! command -v systemd-analyze >/dev/null; then
    echo "check-units: no systemd-analyze (apt-get install systemd)" >&2
    exit 3
fi
for unit in cellctl.service cellctl-guard.service; do
    if told=$(systemd-analyze security --offline=true --threshold=18 --no-pager "$unit"); then
        echo "$told" | tail -n 1
    else
        echo "$told" >&2
        exit 1
    fi
done
