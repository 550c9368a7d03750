"""The command `decklander`, also as `python -m decklander`."""

import sys

from decklander.place import PACKAGES, claim, unhide


def main() -> int:
    """Run a command; return its exit code."""
    try:
        claim(*PACKAGES)
    except ImportError as why:
        sys.stderr.write(f"decklander: {why}\n")
        return 2
    unhide()
    from companion.cli.main import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
