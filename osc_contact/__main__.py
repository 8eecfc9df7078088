"""`python -m osc_contact`: the command line."""

from osc_contact.cli import app

if __name__ == "__main__":
    app()
