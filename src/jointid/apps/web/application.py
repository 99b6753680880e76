"""The page as an application: its addresses, what guards them, and how it starts and stops."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from jointid.apps.web import pages, routes_joint, routes_record, routes_runs
from jointid.apps.web.app_state import AppState
from jointid.apps.web.folder import PageError
from jointid.apps.web.guard import Guard
from jointid.apps.web.limits import Limits


class _Number(IntegerConvertor):
    """A number in an address, of few digits: Python refuses to read thousands, and systems to look for such a file."""

    regex = "[0-9]{1,9}"


register_url_convertor("number", _Number())


def build_application(folder: Path, token: str, host: str = "127.0.0.1", limits: Limits | None = None) -> Starlette:
    """Return the page as an ASGI application.

    Args:
        folder: in which everything is kept.
        token: the first part of every address; requests without it are refused.
        host: under which it is reached.
        limits: of uploads and runs.
    """
    state = AppState(folder, token, limits or Limits())

    async def show_refusal(request: Request, error: Exception) -> Response:
        return pages.show_message(state, 422, "That cannot be done", str(error))

    async def show_not_found(request: Request, error: Exception) -> Response:
        return pages.show_message(state, 404, "Not found", "There is nothing at this address.")

    async def show_failure(request: Request, error: Exception) -> Response:
        sentence = f"This is a fault of ours ({type(error).__name__}: {error}); please report it. Your data is kept."
        return pages.show_message(state, 500, "The page failed", sentence)

    @contextlib.asynccontextmanager
    async def live(_: Starlette) -> AsyncIterator[None]:
        state.folder.close_interrupted()
        yield
        await state.jobs.close()

    application = Starlette(
        routes=[Mount(state.root, routes=_ROUTES)],
        middleware=[Middleware(Guard, host=host, token=token)],
        exception_handlers={PageError: show_refusal, 404: show_not_found, 405: show_not_found, 500: show_failure},
        lifespan=live,
    )
    application.state.page = state
    return application


_ROUTES = [
    Route("/", routes_record.show_record),
    Route("/record", routes_record.take_record, methods=["POST"]),
    Route("/example", routes_record.make_example, methods=["POST"]),
    Route("/again", routes_record.read_again, methods=["POST"]),
    Route("/channels", routes_record.show_channels, methods=["GET"]),
    Route("/channels", routes_record.check_channels, methods=["POST"]),
    Route("/plot/{column:number}.svg", routes_record.draw_column),
    Route("/joint", routes_joint.show_joint, methods=["GET"]),
    Route("/joint", routes_joint.identify, methods=["POST"]),
    Route("/jointfile", routes_joint.import_joint_file, methods=["POST"]),
    Route("/draft", routes_joint.save_draft, methods=["POST"]),
    Route("/runs/{number:number}", routes_runs.show_run),
    Route("/runs/{number:number}/events", routes_runs.stream_progress),
    Route("/runs/{number:number}/cancel", routes_runs.cancel_run, methods=["POST"]),
    Route("/runs/{number:number}/{name:str}", routes_runs.send_file),
    Mount("/static", StaticFiles(packages=[("jointid.apps.web", "static")])),
]
