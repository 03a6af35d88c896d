"""The command ``apel``, which ``python -m apel`` and ``python -m jobs`` are too."""

import sys

from jobs.cli.user_modules import leave_working_directory
from jobs.missing_extra import missing_service


def run() -> None:
    """Run the command; nothing but the standard library's own modules is imported before the path is settled."""
    leave_working_directory()
    try:
        from jobs.cli.main import main
    except ModuleNotFoundError as error:
        message = missing_service(error)
        if not message:
            raise
        sys.stderr.write(f"error: {message}\n")
        raise SystemExit(2) from None
    main()


if __name__ == "__main__":
    run()
