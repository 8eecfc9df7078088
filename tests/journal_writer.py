"""A process that appends rows to a journal and says after each chunk how many are written.

python tests/journal_writer.py FILE [ROWS_OF_A_CHUNK [CHUNKS]]
"""

import sys
from itertools import count
from pathlib import Path

import numpy as np

from osc_contact.recorder.journal import JournalFile

ROW = np.dtype([("tick", "<i8"), ("numbers", "<f8", (120,))])


def rows(first, k):
    """Rows that say what they ought to hold."""
    out = np.zeros(k, ROW)
    out["tick"] = np.arange(first, first + k)
    out["numbers"] = np.sin(out["tick"])[:, None] + np.arange(120)
    return out


if __name__ == "__main__":
    k = int(sys.argv[2]) if len(sys.argv) > 2 else 100
    journal = JournalFile(Path(sys.argv[1]), {"ticks": 1 << 40})
    for chunk in range(int(sys.argv[3])) if len(sys.argv) > 3 else count():
        journal.append(chunk * k, rows(chunk * k, k))
        told = journal.error or (chunk + 1) * k
        print(told, flush=True)
        if journal.error:
            break
