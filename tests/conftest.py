"""What was made at collection stays: the garbage collector need not look at it time and again."""

import gc


def pytest_collection_finish():
    gc.collect()
    gc.freeze()
