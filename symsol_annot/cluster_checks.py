"""Are a Dask scheduler and its workers fit to make a set?"""

import asyncio
import socket
from collections.abc import Mapping
from typing import Any

from distributed import Security
from distributed.comm.addressing import get_address_host_port
from distributed.core import rpc

from symsol_annot import __version__
from symsol_annot.blender_process import RENDERING_PYTHON
from symsol_annot.errors import ClusterError

CONNECT_SECONDS = 10.0
DECIDE_BYTES = ("bpy", "h5py", "numpy", "zlib-ng")  # Mesa and HDF5 are compared when a shard arrives


def check_scheduler(address: str) -> None:
    """Check that a Dask scheduler answers at an address.

    Raises:
        ClusterError: nobody answers, or something else does.
    """

    async def identity() -> Any:
        connection_args = Security().get_connection_args("client")
        async with rpc(address, connection_args=connection_args) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), CONNECT_SECONDS)

    _check_somebody_listens(address)
    try:
        answer = asyncio.run(identity())
        found = answer["type"] if isinstance(answer, dict) and "type" in answer else answer
    except Exception as error:  # noqa: BLE001 - whatever a stranger's answer makes of Dask
        found = type(error).__name__
    if found != "Scheduler":
        what = {"Worker": "a Dask worker", "Nanny": "a Dask nanny"}.get(
            str(found), "something that is no Dask scheduler"
        )
        raise ClusterError(
            f"--cluster {address}: {what} answers there. Give the address that `dask scheduler` prints at its start"
        )


def _check_somebody_listens(address: str) -> None:
    try:
        socket.create_connection(get_address_host_port(address), timeout=CONNECT_SECONDS).close()
    except (ValueError, OverflowError) as error:
        raise ClusterError(
            f"--cluster {address}: is no address ({error}); expected one like tcp://10.0.0.1:8786"
        ) from None
    except OSError as error:
        why = error.strerror or str(error)
        raise ClusterError(
            f"--cluster {address}: nobody answers there ({why}). Start a scheduler with `dask scheduler`, "
            "or correct the address"
        ) from None


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
