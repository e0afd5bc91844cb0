"""Where a Dask scheduler listens: its address, as given or in a file, and whether the way there is protected."""

import ipaddress
import json
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from distributed.comm.addressing import parse_address, unparse_host_port

from symsol_annot.errors import ClusterError
from symsol_annot.system.reading import read_text

_PROTOCOLS = ("tcp", "tls")
_EXPECTED = "expected one like tcp://10.0.0.1:8786 or tls://10.0.0.1:8786"
_PLACE = re.compile(r"(?:\[([^\s\[\]/]+)\]|([^\s\[\]/:]+)):([0-9]{1,5})")  # [IPv6]:port or host:port
_FILE_LIMIT = 2**16  # bytes; a scheduler's file has about 2 kB, and 300 more per worker
_SHOWN = 200  # characters of a wrong address


@dataclass(frozen=True)
class SchedulerAddress:
    """Where a scheduler listens, and by which protocol."""

    protocol: str
    host: str
    port: int

    @property
    def is_encrypted(self) -> bool:
        """Whether the connection is by TLS."""
        return self.protocol == "tls"

    def by(self, protocol: str) -> str:
        """Return the address of this place by a protocol."""
        return f"{protocol}://{unparse_host_port(self.host, self.port)}"

    def __str__(self) -> str:
        return self.by(self.protocol)


def read_address(text: str) -> SchedulerAddress:
    """Return the address that a text like tls://10.0.0.1:8786 stands for; without a protocol, Dask's default holds.

    Raises:
        ValueError: it is none, or one by a protocol that is not spoken here; the message says why.
    """
    if not text.isprintable():
        raise ValueError(f"it has characters that no address has; {_EXPECTED}")
    protocol, place = parse_address(text)
    if protocol not in _PROTOCOLS:
        raise ValueError(
            f"{protocol}:// is not spoken here; start the scheduler with `--protocol tcp` or `--protocol tls`: "
            f"{_EXPECTED}"
        )
    match = _PLACE.fullmatch(place)
    if match is None:
        raise ValueError(f"it names no host and port; {_EXPECTED}")
    port = int(match[3])
    if not 0 < port < 2**16:
        raise ValueError(f"there is no port {port}; {_EXPECTED}")
    return SchedulerAddress(protocol, match[1] or match[2], port)


def address_in(scheduler_file: Path) -> str:
    """Return the address in a file that `dask scheduler --scheduler-file` wrote.

    Raises:
        ClusterError: it holds none.
    """
    try:
        found = json.loads(read_text(scheduler_file, _FILE_LIMIT))
        address = found.get("address") if isinstance(found, dict) else None
        if not isinstance(address, str):
            raise ValueError('expected a JSON object whose "address" is a text')  # noqa: TRY004, TRY301 - as the others
        return str(read_address(address))
    except OSError as error:
        why = error.strerror or str(error)
    except RecursionError:
        why = "its JSON is nested too deeply"
    except ValueError as error:
        why = str(error)[:_SHOWN]
    raise ClusterError(
        f"{scheduler_file}: holds no address of a scheduler ({why}). "
        f"`dask scheduler --scheduler-file {quote(str(scheduler_file))}` writes one"
    )


def is_unprotected(address: str) -> bool:
    """Return whether an address leads to another machine without TLS; a name that resolves to one does.

    False for what is no address and for a name that cannot be resolved: connecting says so.
    """
    try:
        place = read_address(address)
        found = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)
    except (OSError, ValueError):
        return False
    return not place.is_encrypted and any(not _is_of_this_machine(family, to) for family, *_, to in found)


def _is_of_this_machine(family: int, place: tuple[Any, ...]) -> bool:
    """Ask the kernel from where it would send there: to an address of its own, from that very address."""
    host = str(place[0])
    address = ipaddress.ip_address(host)
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped:
        address = address.ipv4_mapped
    if address.is_loopback or address.is_unspecified:
        return True
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sender:
            sender.connect(place)  # of a datagram's socket: nothing is sent
            return str(sender.getsockname()[0]) == host
    except OSError:
        return False
