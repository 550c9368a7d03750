#!/bin/sh
# Print docs/licences.md with its tables made anew by pip-licenses, of the service and of each extra: sh supply/licences.sh PYTHON
# PYTHON is that of an environment with all of them. Ends with 1 at a licence that pyproject.toml does not allow.
set -eu
python=$1
cd "$(dirname "$0")/.."
names() { sed -n 's/==.*//p' "requirements/$1.txt" | sort; }
listed=$(mktemp)
trap 'rm -f "$listed"' EXIT
sed '/^## The service$/,$d' docs/licences.md
for pins in runtime video ship report lab ros2 compare rl fleet; do
    [ "$pins" = runtime ] && echo "## The service" || printf '\n## The extra `%s`\n' "$pins"
    echo
    # shellcheck disable=SC2046  # one argument for each name
    "$python" -m piplicenses --format markdown --ignore-packages rich-click resvg-py --packages $(names "$pins" | comm -23 - "$listed")
    # The metadata of these hold the text of the MIT License, or nothing, in place of its name.
    sed -n 's/^\(rich-click\|resvg-py\)==\([0-9.]*\).*/\1 \2/p' "requirements/$pins.txt" | while read -r name version; do
        grep -qx "$name" "$listed" || echo "| $name | $version | MIT License |"
    done
    names "$pins" | sort -u -o "$listed" - "$listed"
done
