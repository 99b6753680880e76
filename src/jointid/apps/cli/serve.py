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

    Nothing leaves this machine. The page is stopped by Ctrl-C; what its visitors left stays in the folder, until they
    delete it or do not come back for a week.

    Args:
        host: address to listen at; another than this machine's own lets others on the network in.
        port: to listen at; 0 takes a free one.
        folder: in which records and answers are kept; it is made if it is not there.
        open_: also open the page in the browser.
    """
    from jointid.apps.cli.console import show, tell
    from jointid.apps.web.limits import LOOPBACK
    from jointid.apps.web.serving import others_read
    from jointid.apps.web.serving import serve as served

    def opened(address: str) -> None:
        show(f"The page is at {address} (Ctrl-C stops it); records and answers are kept in {folder}.")
        if host not in LOOPBACK:
            tell(
                f"Warning: {host} lets everyone who reaches this machine use the page, unencrypted and without a "
                "password; use it in a network you trust, or leave --host out."
            )
        if others_read(folder):
            tell(
                f"Warning: other users of this machine may read {folder}, and so the records and answers in it; leave "
                "it to its owner alone (chmod 700), or name another folder by --folder."
            )
        if open_:
            import webbrowser

            webbrowser.open(address)

    served(folder, host, port, opened)
