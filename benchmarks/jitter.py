"""Run the tick on the clock: compute time and wake-up jitter apart.

    python benchmarks/jitter.py [--ticks N] [--json FILE] [--figure FILE]

The same as `osc-contact bench jitter`; measured by `osc_contact.experiments.benchmarks.jitter`.
"""

import sys

from osc_contact.cli import app

if __name__ == "__main__":
    app(["bench", "jitter", *sys.argv[1:]])
