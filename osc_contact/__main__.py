"""`python -m osc_contact`: the command line."""

import sys

from osc_contact.errors import missing


def main() -> None:
    """Run the application, or end with the extra that it needs."""
    try:
        from osc_contact.lab.cli.app import app
    except ModuleNotFoundError as error:
        sys.exit(missing(error) or str(error))
    app()


if __name__ == "__main__":
    main()
