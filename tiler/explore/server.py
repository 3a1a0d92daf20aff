"""Serves the explorer to this computer alone: one page, and one address that draws what it asks for."""

import asyncio
import errno
import os
import secrets
import socket
import sys
import threading
import webbrowser
from typing import TYPE_CHECKING, Any

from tiler.config import Machine
from tiler.errors import TilerError
from tiler.explore.guard import App, Guard
from tiler.explore.page import make_explorer
from tiler.explore.reply import KIND, pack
from tiler.explore.requests import MOST_BYTES, read_ask
from tiler.explore.session import Job, Session, Superseded
from tiler.host import available_threads
from tiler.scene.model import Scene
from tiler.simulation import check_request

if TYPE_CHECKING:
    from starlette.requests import Request
    from uvicorn import Server

ADDRESS = "127.0.0.1"
SECONDS_TO_END = 0.5  # that what still runs is given


def check_libraries() -> None:
    """Raise TilerError where what serves the page is not installed."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError as error:
        raise TilerError(
            f"explore: {error.name} is not installed; allowed: after `pip install 'tilesim[explore]'`"
        ) from None


class Explorer:
    """A page server for a scene. `url` is its address; `run` serves until it is interrupted or `stop` is called."""

    def __init__(self, scene: Scene, machine: Machine | None = None, port: int = 0, threads: int | None = None) -> None:
        """Take the port, 0 for any that is free. Raises TilerError for a port that is taken, and as `tiler.simulate`."""
        check_libraries()
        machine = Machine() if machine is None else machine
        check_request(scene, machine, available_threads() if threads is None else threads)
        self._socket = listen(port)
        self.port = self._socket.getsockname()[1]
        self.token = secrets.token_urlsafe(24)
        self.url = f"http://{ADDRESS}:{self.port}/?token={self.token}"
        page, policy = make_explorer(scene, machine)
        self.session = Session(scene, machine, threads)
        self._server = make_server(Guard(make_app(self.session, page, policy), self.token, self.port), self.session)

    def run(self) -> None:
        """Serve; on the main thread Ctrl-C ends it, and is raised again."""
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._socket.close()

    def stop(self) -> None:
        """Make `run` return soon; from any thread."""
        self._server.should_exit = True

    def close(self) -> bool:
        """End the drawing; whether its thread has ended: a kernel that is being compiled cannot be stopped."""
        self._socket.close()
        return self.session.close(SECONDS_TO_END)


def listen(port: int) -> socket.socket:
    """A socket that listens on the loopback address. Raises TilerError."""
    if not 0 <= port <= 65535:
        raise TilerError(f"port: {port} is not allowed; allowed: 1 to 65535, or 0 for any that is free")
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((ADDRESS, port))
        made.listen(64)
    except OSError as error:
        made.close()
        reason = "in use" if error.errno == errno.EADDRINUSE else f"not to be had ({error.strerror})"
        raise TilerError(f"port: {port} is {reason}; allowed: another one, or 0 for any that is free") from None
    return made


def make_server(app: App, session: Session) -> "Server":
    """A server of uvicorn's that ends the session when it ends itself."""
    import uvicorn

    class _Server(uvicorn.Server):
        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            session.close()
            await super().shutdown(sockets)

    return _Server(
        uvicorn.Config(
            app,
            lifespan="off", ws="none", http="h11", loop="asyncio", log_level="critical", access_log=False, server_header=False,
            timeout_graceful_shutdown=1,
        )
    )  # fmt: skip


def make_app(session: Session, page: str, policy: str) -> App:
    """The application behind the guard."""
    from starlette.applications import Starlette
    from starlette.responses import HTMLResponse, JSONResponse, Response
    from starlette.routing import Route

    def refuse(status: int, text: str) -> Response:
        return JSONResponse({"error": text}, status)

    async def show(request: "Request") -> Response:
        return HTMLResponse(page, headers={"content-security-policy": f"{policy}; frame-ancestors 'none'"})

    async def view(request: "Request") -> Response:
        if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
            return refuse(415, "content-type: is not allowed; allowed: application/json")
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > MOST_BYTES:
                return refuse(413, f"request: is too long; allowed: {MOST_BYTES:,} bytes")
        try:
            job = session.submit(read_ask(body))
            if not await _drawn(job, request):
                session.cancel(job)
                return Response(status_code=499)  # nobody is there to read it
            return Response(pack(job.done.result()), media_type=KIND)
        except Superseded:
            return refuse(409, "superseded")
        except TilerError as error:
            return refuse(422, str(error))
        except RuntimeError as error:
            return refuse(500, f"an error of the simulator: {error}")

    return Starlette(routes=[Route("/", show), Route("/view", view, methods=["POST"])])


async def _drawn(job: Job, request: "Request") -> bool:
    """Wait until a job is done, or nobody waits for it any more; whether it is done."""

    async def gone() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass

    done: asyncio.Future[Any] = asyncio.wrap_future(job.done)
    done.add_done_callback(lambda made: made.cancelled() or made.exception())  # asked for, or asyncio complains of it
    left = asyncio.ensure_future(gone())
    try:
        await asyncio.wait({done, left}, return_when=asyncio.FIRST_COMPLETED)
        return done.done()
    finally:
        left.cancel()


def open_browser(url: str) -> None:
    """Open the address in the user's browser, if there is a screen; it is printed in any case."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in screens):
        print("no display here: open the address in a browser of this computer", file=sys.stderr)
        return

    def attempt() -> None:
        try:
            opened = webbrowser.open(url)
        except (OSError, webbrowser.Error):
            opened = False
        if not opened:
            print("no browser could be started: open the address by hand", file=sys.stderr)

    threading.Thread(target=attempt, daemon=True).start()
