"""Time a whole run on MuJoCo and its parts.

    python benchmarks/simulation.py [--ticks N] [--json FILE] [--figure FILE]

The same as `osc-contact bench simulation`; measured by
`osc_contact.experiments.benchmarks.simulation`.
"""

import sys

from osc_contact.cli import app

if __name__ == "__main__":
    app(["bench", "simulation", *sys.argv[1:]])
