"""The page served by uvicorn: to this machine alone unless another address is asked for."""

from __future__ import annotations

import os
import secrets
import socket
import stat
from collections.abc import Callable
from pathlib import Path

from jointid.apps.web.folder import PageError
from jointid.common.errors import extra

_GRACE = 2  # seconds that an open connection is given when the page ends
_TOKEN = 24  # bytes that nobody guesses


def serve(folder: Path, host: str, port: int, announce: Callable[[str], None]) -> None:
    """Serve the page until it is interrupted.

    Args:
        folder: in which everything is kept; it is made if it is not there, and then its owner alone may read it.
        host: name or address to listen at.
        port: 0 takes a free one.
        announce: is told the page's address, which holds the token, as soon as it can be reached.

    Raises:
        ExtraError: a package of the page is not installed.
        PageError: the folder cannot be made, or the address is taken.
    """
    for module in ("starlette", "python_multipart", "jinja2", "bokeh"):
        extra(module, "web", "The page")
    uvicorn = extra("uvicorn", "web", "The page")
    from jointid.apps.web.application import build_application

    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise PageError(f"{folder} cannot be made a folder ({error.strerror}); name another one by --folder.") from None
    token = secrets.token_urlsafe(_TOKEN)
    with _listen(host, port) as listening:
        config = uvicorn.Config(
            build_application(folder, token, host),
            log_level="warning",
            timeout_graceful_shutdown=_GRACE,
            server_header=False,
        )
        shown = f"[{host}]" if ":" in host else host
        announce(f"http://{shown}:{listening.getsockname()[1]}/{token}/")
        uvicorn.Server(config).run(sockets=[listening])


def write_redirect(folder: Path, address: str) -> Path:
    """Write a file that leads a browser to the page, and return it.

    Other users of the machine see the words with which a browser is started, and must not see the token among them.
    """
    path = folder.absolute() / "open.html"
    path.unlink(missing_ok=True)
    text = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={address}">\n'
    with open(path, "x", encoding="utf-8", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
        file.write(text)
    return path


def others_can_read(folder: Path) -> bool:
    """Return whether other users of this machine may list a folder or reach its files, where the system tells."""
    return os.name == "posix" and bool(folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))


def _listen(host: str, port: int) -> socket.socket:
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
