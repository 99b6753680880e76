"""`jointid serve`: the page in the browser, for those who do not use a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def serve(
    *,
    host: str = "127.0.0.1",
    port: int = 8765,
    folder: Path = Path("jointid-page"),
    open_: Annotated[bool, Parameter(name=["--open", "-o"], negative=())] = False,
) -> None:
    """Serve a page on which a log is dropped, its columns are mapped, and the joint is identified.

    The printed address holds a token, new at each start: who has it uses the page, and nobody else does. Nothing leaves
    this machine. Ctrl-C stops the page; the record and the answers stay in the folder.

    Args:
        host: address to listen at; another than this machine's own lets the network reach it.
        port: to listen at; 0 takes a free one.
        folder: in which records and answers are kept; it is made if it is not there.
        open_: also open the page in the browser.
    """
    from jointid.apps.cli.console import show, tell
    from jointid.apps.web import serving
    from jointid.apps.web.limits import LOOPBACK

    def announce(address: str) -> None:
        show(f"The page is at {address} (Ctrl-C stops it); records and answers are kept in {folder}.")
        if host not in LOOPBACK:
            tell(
                f"Warning: at {host} the network reaches the page. It is not encrypted, so that others there may read "
                "the token and use it; use it in a network you trust, or leave --host out."
            )
        if serving.others_can_read(folder):
            tell(
                f"Warning: other users of this machine may read {folder}, and so the records and answers in it; leave "
                "it to its owner alone (chmod 700), or name another folder by --folder."
            )
        if open_:
            import webbrowser

            webbrowser.open(serving.write_redirect(folder, address).as_uri())

    serving.serve(folder, host, port, announce)
