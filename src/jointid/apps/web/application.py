"""The page as an application: its addresses, what guards them, and how it begins and ends."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from jointid.apps.web import pages
from jointid.apps.web.app_state import Desk
from jointid.apps.web.guard import Guard
from jointid.apps.web.limits import Limits
from jointid.apps.web.routes_record import Recording
from jointid.apps.web.routes_results import Ordering
from jointid.apps.web.routes_runs import Running
from jointid.apps.web.sessions import PageError

_EXPIRE = 3600.0  # seconds between looks for visitors who did not come back


class _Place(IntegerConvertor):
    """A number in an address, of few digits: Python refuses to read thousands, and systems to look for such a file."""

    regex = "[0-9]{1,9}"


register_url_convertor("place", _Place())


def application(folder: Path, host: str = "127.0.0.1", limits: Limits | None = None) -> Starlette:
    """Return the page as an ASGI application.

    Args:
        folder: in which everything is kept.
        host: under which it is reached.
        limits: of what it takes.
    """
    desk = Desk(folder, limits or Limits())

    async def refused(request: Request, error: Exception) -> Response:
        said = pages.message_page(desk.known(request), desk.limits, "That cannot be done", str(error))
        return HTMLResponse(said, 422)

    async def nothing(request: Request, error: Exception) -> Response:
        return desk.nothing(request)

    async def failed(request: Request, error: Exception) -> Response:
        said = f"This is a fault of ours ({type(error).__name__}: {error}); please report it. Your data is kept."
        return HTMLResponse(pages.message_page(None, desk.limits, "The page failed", said), 500)

    made = Starlette(
        routes=_routes(desk),
        middleware=[Middleware(Guard, host=host)],
        exception_handlers={PageError: refused, 404: nothing, 405: nothing, 500: failed},
        lifespan=lambda _: _alive(desk),
    )
    made.state.desk = desk
    return made


def _routes(desk: Desk) -> list[Route]:
    recording, ordering, running = Recording(desk), Ordering(desk), Running(desk)

    async def forget(request: Request) -> Response:
        """Remove everything of a visitor."""
        visitor = desk.known(request)
        if visitor is not None:
            await run_in_threadpool(desk.jobs.forget, visitor)
        said = "Nothing of it is kept on this machine."
        answer = HTMLResponse(pages.message_page(None, desk.limits, "Your data is deleted", said))
        answer.delete_cookie(desk.cookie, path="/")
        return answer

    async def static(request: Request) -> Response:
        """Give a file that pages load."""
        name = request.path_params["name"]
        kind = pages.STATIC.get(name)
        if kind is None:
            return desk.nothing(request)
        return Response(pages.static(name), media_type=kind, headers={"cache-control": "no-cache"})

    return [
        Route("/", recording.start),
        Route("/record", recording.upload, methods=["POST"]),
        Route("/example", recording.example, methods=["POST"]),
        Route("/again", recording.again, methods=["POST"]),
        Route("/channels", recording.channels, methods=["GET"]),
        Route("/channels", recording.save_channels, methods=["POST"]),
        Route("/plot/{column:place}.svg", recording.plot),
        Route("/joint", ordering.joint, methods=["GET"]),
        Route("/joint", ordering.save_joint, methods=["POST"]),
        Route("/jointfile", ordering.import_file, methods=["POST"]),
        Route("/draft", ordering.save_draft, methods=["POST"]),
        Route("/runs/{number:place}", running.run),
        Route("/runs/{number:place}/events", running.events),
        Route("/runs/{number:place}/cancel", running.cancel, methods=["POST"]),
        Route("/runs/{number:place}/{name:str}", running.file),
        Route("/forget", forget, methods=["POST"]),
        Route("/static/{name:str}", static),
    ]


@contextlib.asynccontextmanager
async def _alive(desk: Desk) -> AsyncIterator[None]:
    """Begin with what an earlier run of the page left, and end all that runs with it."""
    await run_in_threadpool(desk.sessions.recover)
    expiring = asyncio.create_task(_expiring(desk))
    try:
        yield
    finally:
        expiring.cancel()
        await run_in_threadpool(desk.jobs.close)


async def _expiring(desk: Desk) -> None:
    while True:
        await run_in_threadpool(desk.sessions.expire)
        await asyncio.sleep(_EXPIRE)
