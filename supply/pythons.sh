#!/bin/sh
# Run `make check` and one demo with every Python of the classifiers that this machine has: sh supply/pythons.sh. Each has an
# environment of its own, .venv-X.Y, beside the ordinary one. A command that does not run, as the shim of a version manager that
# has not chosen that Python, is none; one that pyenv has installed without choosing it is.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
had= missed= failed=
for version in $(sed -n 's/^ *"Programming Language :: Python :: \(3\.[0-9][0-9]*\)",$/\1/p' pyproject.toml); do
    found=
    for python in "python$version" python3 "$(pyenv root 2>/dev/null || true)/versions/$version".*/bin/python3; do
        [ "$("$python" -c 'import ensurepip, sys, venv; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" = "$version" ] || continue
        found=$("$python" -c 'import platform, sys; print(platform.python_version(), sys.executable)')
        break
    done
    if [ -z "$found" ]; then
        missed="$missed $version"
        continue
    fi
    had="$had ${found%% *}"
    echo "== Python $found"
    if ! make --no-print-directory VENV=".venv-$version" PYTHON="$python" check; then
        failed="$failed ${found%% *} (check)"
    elif ! PYTHONWARNINGS=error::DeprecationWarning ".venv-$version/bin/decklander" demo --report "$work/$version"; then
        failed="$failed ${found%% *} (demo)"
    fi
done
echo "Pythons of the classifiers: checked${had:- none}; not on this machine:${missed:- none}; failed:${failed:- none}"
[ -n "$had" ] && [ -z "$failed" ]
