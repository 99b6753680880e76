"""The command `jointid serve`: the page in the browser."""

from __future__ import annotations

import os
import secrets
import socket
from pathlib import Path

from jointid.apps.cli.console import show, tell
from jointid.common.errors import JointidError, extra
from jointid.common.files import explain, lock, require_room

_HOST = "127.0.0.1"  # not reachable from other machines
_TOKEN = 24  # random bytes


def serve(*, port: int = 8765, folder: Path = Path("jointid-page")) -> None:
    """Serve the page in the browser.

    The page takes a log, maps its columns and identifies the joint.
    The printed address contains a token, new at each start; only users of this address have access. No data leaves
    this machine. Ctrl-C stops the page; the record and the answers stay in the folder.

    Args:
        port: to listen on; 0 takes a free one.
        folder: for records and answers; it is created if missing.
    """
    for module in ("uvicorn", "starlette", "python_multipart"):
        extra(module, "web", "The page")
    from jointid.apps.web.routes import build_application, run

    require_room(folder)
    with explain(folder):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    token = secrets.token_urlsafe(_TOKEN)
    with socket.socket() as listening, (folder / "_lock").open("a") as held:
        if not lock(held.fileno()):
            raise JointidError(f"Another page works in {folder}; close it, or choose another --folder.")
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((_HOST, port))
            listening.listen()
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise JointidError(f"The page cannot listen at port {port} ({reason}); choose another --port.") from None
        address = f"http://{_HOST}:{listening.getsockname()[1]}/{token}/"
        show(f"The page is at {address} (Ctrl-C stops it); records and answers are kept in {folder}.")
        if os.name == "posix" and folder.stat().st_mode & 0o077:
            tell(f"Warning: other users of this machine may reach {folder} and its records; set its mode (chmod 700).")
        run(build_application(folder, token), listening)
