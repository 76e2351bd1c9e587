"""`python -m geomag` and the `geomag` command."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line."""
    from geomag._errors import MissingDependencyError

    try:
        from geomag.cli import run
    except MissingDependencyError as error:
        sys.stderr.write(f"geomag: {error}\n")
        sys.exit(1)
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
