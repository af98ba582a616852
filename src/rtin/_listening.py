"""Where servers listen, and what is said where they cannot."""

from __future__ import annotations

import errno
import socket

__all__ = ["address", "listening"]


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 is any free one.

    Raises OSError where the port is taken or may not be used, or there is no such host, and
    ValueError where the port is not one from 0 to 65535.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"port must be 0 to 65535, got {port}")
    try:
        family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(place[:2], family=family, backlog=512)
    except OSError as error:
        raise OSError(f"cannot serve on port {port} of {host}: {_remedy(error)}") from None


def _remedy(error: OSError) -> str:
    """Return what is wrong and what to do."""
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address; 127.0.0.1 is this machine alone, 0.0.0.0 all"
    taken = error.errno == errno.EADDRINUSE
    reason = "another program uses it" if taken else error.strerror or str(error)
    return f"{reason}; choose another port, or 0 for any that is free"


def address(host: str, port: int) -> str:
    """Return what to type into a browser on this machine."""
    name = "localhost" if host in ("0.0.0.0", "::", "") else host
    return f"http://[{name}]:{port}/" if ":" in name else f"http://{name}:{port}/"
