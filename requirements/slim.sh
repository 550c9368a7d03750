#!/bin/sh
# Take out of an environment what the service does not use: sh requirements/slim.sh /opt/decklander
set -eu
lib="$1/lib"
# The compiler of the native core, where there was no cc.
if ls -d "$lib"/python3*/site-packages/ziglang >/dev/null 2>&1; then
    "$1/bin/python" -m pip uninstall --quiet --yes ziglang
fi
# Tests of libraries; what only builds or checks code; lxml, which only pymavlink's generator needs; the installer.
find "$lib" -type d -name tests -prune -exec rm -r {} +
find "$lib" -type f \( -name '*.pyi' -o -name '*.pxd' -o -name '*.h' -o -name '*.a' \) -delete
for unused in numpy/f2py numpy/distutils lxml pip 'pip-*' setuptools 'setuptools-*' pkg_resources _distutils_hack \
    distutils-precedence.pth; do
    # shellcheck disable=SC2086
    rm -rf "$lib"/python3*/site-packages/$unused
done
rm -f "$1"/bin/pip*
# Trained detectors of faces; dialects of MAVLink other than v20/common, which drivers/ names.
find "$lib" -path '*/cv2/data/*.xml' -delete
find "$lib" -type f -path '*/pymavlink/dialects/v*' ! -name '__init__*' ! -path '*/v20/*common.*py*' -delete
# Where binutils is installed, symbols for debuggers. Libraries below *.libs were moved to fit beside each other: strip would break them.
if command -v strip >/dev/null; then
    find "$lib" -name '*.so' ! -path '*.libs/*' -exec strip --strip-unneeded {} +
fi
