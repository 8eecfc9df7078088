"""Time the tick over arms, degree of constraint and contacts.

    python benchmarks/scaling.py [--ticks N] [--json FILE] [--figure FILE]

The same as `osc-contact bench scaling`; measured by `osc_contact.experiments.benchmarks.scaling`.
"""

import sys

from osc_contact.cli import app

if __name__ == "__main__":
    app(["bench", "scaling", *sys.argv[1:]])
