#!/bin/sh
# Take out of an environment what the service does not use: sh requirements/slim.sh /opt/decklander
# Tests of libraries, dialects of MAVLink for other vehicles and, where binutils is installed, symbols for debuggers.
set -eu
lib="$1/lib"
find "$lib" -type d -name tests -prune -exec rm -r {} +
# The compiler of the native core, where there was no cc.
if ls -d "$lib"/python3*/site-packages/ziglang >/dev/null 2>&1; then
    "$1/bin/python" -m pip uninstall --quiet --yes ziglang
fi
# We speak v20/common; pymavlink itself loads v10/all or v20/all where nobody names a dialect.
find "$lib" -type f -path '*/pymavlink/dialects/v*' ! -name '__init__*' ! -name 'all.*py*' ! -path '*/v20/*common.*py*' -delete
# Libraries below *.libs were moved to fit beside each other, and strip would break them.
if command -v strip >/dev/null; then
    find "$lib" -name '*.so' ! -path '*.libs/*' -exec strip --strip-unneeded {} +
fi
