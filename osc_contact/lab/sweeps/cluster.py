"""The workers of a dask cluster (extra `cluster`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from distributed import Client

from osc_contact import __version__
from osc_contact.errors import InvalidInputError

_PATIENCE_S = 20.0  #: for a scheduler that does not answer, and for the first worker


@contextmanager
def connect(scheduler: str | Client) -> Iterator[Client]:
    """The client of a cluster that has workers with this package.

    Args:
        scheduler: an address such as tcp://10.0.0.1:8786; or a client, left open.

    Raises:
        InvalidInputError: it does not answer, has no workers, or theirs is another osc_contact.
    """
    client: Any = scheduler
    try:
        if isinstance(scheduler, str):
            client = Client(scheduler, timeout=_PATIENCE_S)
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
    return __version__
