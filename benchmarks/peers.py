"""Time the tick beside what else could be run in its place.

    python benchmarks/peers.py [--ticks N] [--tsid-python PATH] [--json FILE] [--figure FILE]

The same as `osc-contact bench peers`; measured by `osc_contact.experiments.benchmarks.peers`.
"""

import sys

from osc_contact.cli import app

if __name__ == "__main__":
    app(["bench", "peers", *sys.argv[1:]])
