"""Workers of a dask cluster (extra `cluster`)."""

from collections.abc import Iterator
from contextlib import contextmanager

from distributed import Client

from osc_contact import __version__
from osc_contact.errors import InvalidInputError

_PATIENCE_S = 20.0  #: time to wait for the scheduler, and for the first worker (s)


@contextmanager
def connect(scheduler: str | Client) -> Iterator[Client]:
    """Yield the client of a cluster whose workers have this version of the package.

    Args:
        scheduler: an address such as tcp://10.0.0.1:8786, or a client, which is not closed.

    Raises:
        InvalidInputError: the scheduler does not answer, or its workers are missing or have another
            version of osc_contact.
    """
    try:
        client = Client(scheduler, timeout=_PATIENCE_S) if isinstance(scheduler, str) else scheduler
        client.wait_for_workers(1, timeout=_PATIENCE_S)
        versions = set(client.run(_version).values())
    except (OSError, ValueError, ImportError) as error:
        raise InvalidInputError(
            f"the cluster of {scheduler} cannot be used ({error}); start `dask scheduler`, `dask "
            "worker ADDRESS` with the address it prints, and give that, too"
        ) from error
    if versions != {__version__}:
        raise InvalidInputError(
            f"this is osc_contact {__version__}, the workers have {sorted(versions)}, whose "
            "numbers may differ"
        )
    try:
        yield client
    finally:
        if client is not scheduler:
            client.close()


def _version() -> str:
    """Version of the package in the worker that runs this function."""
    return __version__
