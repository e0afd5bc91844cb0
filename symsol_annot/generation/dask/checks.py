"""Are a Dask scheduler and its workers fit to make a set?"""

import asyncio
import logging
import socket
import ssl
import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from distributed import Security
from distributed.core import rpc

from symsol_annot import __version__
from symsol_annot.errors import ClusterError
from symsol_annot.generation.dask.address import SchedulerAddress, read_address
from symsol_annot.generation.dask.tls import (
    GUIDE,
    TLS_OPTIONS,
    client_context,
    failure_in_words,
    is_encryption_required,
)
from symsol_annot.rendering.blender_process import RENDERING_PYTHON

CONNECT_SECONDS = 10.0
DECIDE_BYTES = ("bpy", "h5py", "numpy", "zlib-ng")  # Mesa and HDF5 are compared when a shard arrives

_SILENCE_SECONDS = 2.0  # after which a server is asked whether it speaks TLS
_HANDSHAKE_LIMIT = 2**16  # bytes; Dask's has 66
_HANDSHAKE_MARK = b"pickle-protocol"
_NO_SCHEDULER = (
    "something that is no Dask scheduler answers there. Give the address that `dask scheduler` prints at its start"
)


def check_scheduler(text: str) -> None:
    """Check that a Dask scheduler answers at an address.

    A server whose handshake is not Dask's is never handed to Dask, which would unpickle what it sends, and take memory
    for as many bytes as it announces.

    Args:
        text: the address, like tcp://10.0.0.1:8786.

    Raises:
        ClusterError: no server answers, or one that is no scheduler, or TLS is missing on a side or fails.
    """
    try:
        address = read_address(text)
    except ValueError as error:
        raise ClusterError(f"--cluster {text}: is no address: {error}") from None
    fault = _fault_of(address) or _fault_of_identity(address)
    if fault:
        raise ClusterError(f"--cluster {text}: {fault}")


def _fault_of(address: SchedulerAddress) -> str | None:
    """Connect, and say what keeps Dask from doing so; None where a Dask server answers."""
    if not address.is_encrypted and is_encryption_required():
        return (
            "tcp:// has no encryption, which distributed.comm.require-encryption demands in Dask's configuration. Give "
            f"{address.by('tls')}, and have the scheduler speak TLS ({GUIDE}); or set that to false"
        )
    context = client_context() if address.is_encrypted else None
    try:
        connection = _connection(address, CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        why = (isinstance(error, OSError) and error.strerror) or str(error)
        return f"nobody answers there ({why}). Start a scheduler with `dask scheduler`, or correct the address"
    with connection:
        return _fault_of_tcp(connection, address) if context is None else _fault_of_tls(connection, context, address)


def _connection(address: SchedulerAddress, seconds: float) -> socket.socket:
    return socket.create_connection((address.host, address.port), timeout=seconds)


def _fault_of_tcp(connection: socket.socket, address: SchedulerAddress) -> str | None:
    if _is_silent(connection) and _speaks_tls(address):  # where the client speaks first
        return (
            f"a server that speaks TLS answers there, and waits for it. Give --cluster {address.by('tls')}, and tell "
            f"Dask of this command's certificates ({GUIDE})"
        )
    try:
        return None if _is_dask_handshake(connection) else _NO_SCHEDULER
    except OSError:
        return _NO_SCHEDULER


def _is_silent(connection: socket.socket) -> bool:
    connection.settimeout(_SILENCE_SECONDS)
    try:
        connection.recv(1, socket.MSG_PEEK)
    except TimeoutError:
        return True
    except OSError:
        pass
    return False


def _fault_of_tls(connection: socket.socket, context: ssl.SSLContext, address: SchedulerAddress) -> str | None:
    try:
        with context.wrap_socket(connection) as encrypted:
            return None if _is_dask_handshake(encrypted) else _NO_SCHEDULER  # TLS 1.3 refuses a certificate only now
    except ssl.SSLError as error:
        fault = failure_in_words(error)
        if fault:
            return f"the TLS connection failed: {fault}"
    except OSError:  # silent, or it hung up
        return _NO_SCHEDULER
    if not _speaks_dask_by_tcp(address):
        return _NO_SCHEDULER
    return (
        f"a Dask scheduler without TLS answers there. Start it with `dask scheduler --protocol tls{TLS_OPTIONS}`; "
        "certificates in its environment alone need "
        "`export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=True` there. Where nobody else reaches that network, "
        f"--cluster {address.by('tcp')} does without"
    )


def _is_dask_handshake(connection: socket.socket) -> bool:
    """Tell whether a server begins as Dask does, reading no more bytes than a handshake of Dask's has.

    Raises:
        OSError: it ended the connection or said nothing in time.
    """
    end = time.monotonic() + CONNECT_SECONDS
    (length,) = struct.unpack("<Q", _received(connection, 8, end))
    return length <= _HANDSHAKE_LIMIT and _HANDSHAKE_MARK in _received(connection, length, end)


def _received(connection: socket.socket, length: int, end: float) -> bytes:
    data = b""
    while len(data) < length:
        left = end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        connection.settimeout(left)
        more = connection.recv(length - len(data))
        if not more:
            raise ConnectionResetError
        data += more
    return data


def _speaks_tls(address: SchedulerAddress) -> bool:
    anybody = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    anybody.check_hostname, anybody.verify_mode = (
        False,
        ssl.CERT_NONE,
    )  # no data are sent: only whether it speaks TLS is asked
    try:
        with _connection(address, _SILENCE_SECONDS) as connection, anybody.wrap_socket(connection):
            return True
    except ssl.SSLError as error:
        return failure_in_words(error) is not None
    except OSError:
        return False


def _speaks_dask_by_tcp(address: SchedulerAddress) -> bool:
    with suppress(OSError), _connection(address, CONNECT_SECONDS) as connection:
        return _is_dask_handshake(connection)
    return False


def _fault_of_identity(address: SchedulerAddress) -> str | None:
    """Ask a Dask server what it is; None where it is a scheduler."""

    async def identity() -> Any:
        connection_args = Security().get_connection_args("client")
        async with rpc(str(address), connection_args=connection_args) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), CONNECT_SECONDS)

    try:
        with silent_dask():
            answer = asyncio.run(identity())
        found = answer["type"] if isinstance(answer, dict) and "type" in answer else answer
    except Exception as error:  # noqa: BLE001 - whatever an unknown answer makes of Dask
        found = type(error).__name__
    if found == "Scheduler":
        return None
    what = {"Worker": "a Dask worker", "Nanny": "a Dask nanny"}.get(str(found), "something that is no Dask scheduler")
    return f"{what} answers there. Give the address that `dask scheduler` prints at its start"


@contextmanager
def silent_dask() -> Iterator[None]:
    """Keep Dask's client from printing tracebacks of what becomes a ClusterError here."""
    logs = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def worker_options(scheduler: str) -> str:
    """Return the options that `dask worker` needs beyond a scheduler's address."""
    return TLS_OPTIONS if read_address(scheduler).is_encrypted else ""


def faults_of_encryption(scheduler: str, workers: Iterable[str]) -> list[str]:
    """Say which workers of a scheduler with TLS have none: a line each.

    Args:
        scheduler: its address.
        workers: their addresses. Shards would leave them in the clear, and who reaches them runs code there.
    """
    if not read_address(scheduler).is_encrypted:
        return []
    return [
        f"{worker} listens without TLS: start it with `dask worker {scheduler} --protocol tls{TLS_OPTIONS}`"
        for worker in workers
        if not worker.startswith("tls://")
    ]


def worker_faults(packages: Mapping[str, Mapping[str, str | None]]) -> list[str]:
    """Say what keeps workers from making the same bytes: a line each.

    Args:
        packages: by worker, the versions of Python and of packages; None for one that is not installed.
    """
    faults = []
    for worker, versions in packages.items():
        python = ".".join(str(versions["python"]).split(".")[:2])
        needed = ".".join(map(str, RENDERING_PYTHON))
        if python != needed:
            faults.append(f"{worker} runs Python {python}; Blender's module bpy needs {needed}")
        elif versions["symsol-annot"] is None:
            faults.append(f"{worker} lacks symsol-annot: there, `pip install 'symsol-annot[render,cluster]'`")
        elif versions["symsol-annot"] != __version__:
            faults.append(f"{worker} has symsol-annot {versions['symsol-annot']}, this command is {__version__}")
        elif versions["bpy"] is None:
            faults.append(f"{worker} lacks bpy: there, `pip install 'symsol-annot[render]'`")
    return faults or _differences(packages)


def _differences(packages: Mapping[str, Mapping[str, str | None]]) -> list[str]:
    differences = []
    for name in DECIDE_BYTES:
        found: dict[str | None, str] = {}
        for worker, versions in packages.items():
            found.setdefault(versions[name], worker)
        if len(found) > 1:
            having = ", ".join(f"{version} on {worker}" for version, worker in found.items())
            differences.append(f"{name} is not the same everywhere, and would make other bytes: {having}")
    return differences
