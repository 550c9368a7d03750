#!/bin/sh
# Install pinned packages by one call of pip, and print what that took: sh supply/install.sh PYTHON PINS...
# A file of pins names every package, so there is nothing to resolve. Python compiles what it imports, so pip does so only where Python
# may keep no byte code.
set -eu
python=$1
shift
compile=--no-compile
[ -z "${PYTHONDONTWRITEBYTECODE:-}" ] || compile=--compile
echo "fetching the packages of $* ..."
for pins in "$@"; do
    set -- "$@" -r "$pins"
    shift
done
began=$(date +%s)
{ "$python" -u -m pip install --disable-pip-version-check --progress-bar=off --no-deps --require-hashes $compile "$@" || echo "failed $?"; } | {
    sizes= fetched= packages=0 failed=
    while read -r line; do
        case $line in
        *".metadata ("*) ;;
        "Downloading "*")") sizes="$sizes ${line##*\(}" ;;
        "Installing collected packages: "*) fetched=$(date +%s) packages=$(($(echo "$line" | wc -w) - 3)) ;;
        "failed "*) failed=${line#failed } ;;
        esac
    done
    [ -z "$failed" ] || exit "$failed"
    now=$(date +%s)
    files=$(echo "$sizes" | awk '{ for (i = 1; i < NF; i += 2) mb += $i * ($(i + 1) ~ /^k/ ? .001 : $(i + 1) ~ /^M/ ? 1 : $(i + 1) ~ /^G/ ? 1000 : 0)
        printf "%d files, %.1f MB", NF / 2, mb }')
    echo "downloaded $files, in $((${fetched:-$now} - began)) s; installed $packages packages in $((now - ${fetched:-$now})) s"
}
