"""The page served: by uvicorn, to this machine alone unless another address is asked for."""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

from jointid.apps.web.sessions import PageError
from jointid.common.extras import extra

_GRACE = 2  # seconds that an open connection is given when the page ends


def serve(folder: Path, host: str, port: int, opened: Callable[[str], None]) -> None:
    """Serve the page until it is interrupted.

    Args:
        folder: in which everything is kept; it is made if it is not there, and then its owner alone may read it.
        host: name or address to listen at.
        port: 0 takes a free one.
        opened: is told the page's address as soon as it can be reached.

    Raises:
        ExtraError: what serves is not installed.
        PageError: the folder cannot be made, or the address is taken.
    """
    for module in ("starlette", "python_multipart", "jinja2", "bokeh"):
        extra(module, "web", "The page")
    uvicorn = extra("uvicorn", "web", "The page")
    from jointid.apps.web.application import application

    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise PageError(f"{folder} cannot be made a folder ({error.strerror}); name another one by --folder.") from None
    listening = _listening(host, port)
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{listening.getsockname()[1]}/"
    config = uvicorn.Config(
        application(folder, host), log_level="warning", timeout_graceful_shutdown=_GRACE, server_header=False
    )
    server = uvicorn.Server(config)
    opened(address)
    with listening:
        server.run(sockets=[listening])


def others_read(folder: Path) -> bool:
    """Return whether other users of this machine may list a folder or reach what is in it, where the system tells."""
    return os.name == "posix" and bool(folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))


def _listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens there.

    Raises:
        PageError: it cannot.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or error
        raise PageError(f"{host} port {port} cannot be listened at ({reason}); choose another --port.") from None
    listening.listen()
    return listening
