"""A dask cluster: one that runs somewhere, or one of this machine alone (extra `cluster`)."""

from collections.abc import Iterator
from contextlib import contextmanager

from distributed import Client, LocalCluster, Worker, WorkerPlugin

from osc_contact import __version__
from osc_contact.errors import InvalidInputError

LOCAL = "local"  #: the scheduler that is made for the occasion
_PATIENCE_S = 20.0  #: for a scheduler that does not answer, and for the first worker


@contextmanager
def connect(scheduler: str | Client, workers: int | None = None) -> Iterator[Client]:
    """The client of a cluster that has workers with this package.

    Args:
        scheduler: an address such as tcp://10.0.0.1:8786; "local"; or a client, left open.
        workers: processes of "local"; None: one for each core.

    Raises:
        InvalidInputError: it does not answer or has no workers; theirs is another osc_contact;
            `workers` of a cluster that has its own.
    """
    if scheduler == LOCAL:
        with _local(workers) as cluster, Client(cluster) as client:
            client.register_plugin(_NoPages())
            yield client
        return
    if workers is not None:
        raise InvalidInputError(
            f"{workers} workers were requested, but a cluster has its own; leave workers out"
        )
    if isinstance(scheduler, Client):
        _require_workers(scheduler)
        yield scheduler
        return
    try:
        client = Client(scheduler, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"no scheduler answers at {scheduler!r} ({error}); start one with `dask scheduler` and "
            "give the address it prints, such as tcp://10.0.0.1:8786"
        ) from error
    with client:
        _require_workers(client)
        yield client


def _local(workers: int | None) -> LocalCluster:
    """Processes of this machine, reached through its loopback only, without pages."""
    cluster = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
    )
    cluster.scheduler.http_server.stop()
    return cluster


class _NoPages(WorkerPlugin):  # type: ignore[misc]
    """Closes the port on which a worker reports its state."""

    def setup(self, worker: Worker) -> None:
        worker.http_server.stop()


def _require_workers(client: Client) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError as error:
        raise InvalidInputError(
            f"{client.scheduler.address} has had no workers for {_PATIENCE_S:g} s; start some with "
            f"`dask worker {client.scheduler.address}`"
        ) from error
    try:
        found = client.run(_version)
    except ImportError as error:
        raise InvalidInputError(f"a worker cannot import osc_contact: {error}") from error
    others = {address: one for address, one in found.items() if one != __version__}
    if others:
        raise InvalidInputError(
            f"this is osc_contact {__version__}, the workers have others, whose numbers may "
            f"differ: {others}"
        )


def _version() -> str:
    return __version__
