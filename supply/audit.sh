#!/bin/sh
# Look the pins of the service and its extras up among known weaknesses: sh supply/audit.sh PIP_AUDIT [OPTION ...]
# Ends with 1 when a pinned version has a known weakness. Where the advisories cannot be reached it says so and ends with 0, unless
# --strict is among the options, which are pip-audit's own.
set -u
audit=$1
shift
pins=$(dirname "$0")/../requirements
found=$(timeout 120 "$audit" --disable-pip --require-hashes --progress-spinner off --timeout 5 "$@" \
    -r "$pins/runtime.txt" -r "$pins/report.txt" -r "$pins/lab.txt" -r "$pins/ros2.txt" \
    -r "$pins/compare.txt" -r "$pins/rl.txt" -r "$pins/fleet.txt" -r "$pins/ship.txt" -r "$pins/video.txt" 2>&1)
code=$?
case $found in
*"Found "[0-9]*" known vulnerabilit"*)
    echo "$found"
    exit 1
    ;;
*"could not be audited"*) ;;
*)
    if [ "$code" = 0 ]; then
        echo "$found"
        exit 0
    fi
    ;;
esac
echo "THE AUDIT COULD NOT BE MADE: $(echo "$found" | tail -n 1)"
echo "make audit OSV=URL asks a server of the OSV interface that can be reached instead of PyPI"
case " $* " in
*" --strict "*) exit "$code" ;;
esac
