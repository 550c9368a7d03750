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
{ "$python" -m pip install --disable-pip-version-check --progress-bar=off --no-deps --require-hashes $compile "$@" || echo "ended with $?"; } | awk '
BEGIN { "date +%s" | getline began; close("date +%s"); megabytes["kB"] = .001; megabytes["MB"] = 1; megabytes["GB"] = 1000 }
/ Downloading .*\)$/ && !/\.metadata \(/ { files++; size = $(NF - 1); unit = $NF; sub(/\(/, "", size); sub(/\)/, "", unit); all += size * megabytes[unit] }
/^Installing collected packages: / { "date +%s" | getline fetched; close("date +%s"); packages = NF - 3 }
/^ended with / { failed = $3 }
END {
  if (failed) exit failed
  "date +%s" | getline now
  if (!fetched) fetched = now
  printf "downloaded %d files, %.1f MB, in %d s; installed %d packages in %d s\n", files, all, fetched - began, packages, now - fetched
}'
