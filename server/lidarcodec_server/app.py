"""create_app: the server as an ASGI application. Its lifespan opens and closes everything.

Routes are in `routes/`; each module named in ROUTERS has a `router`. PARTS names everything else that lives as long as
the app: functions that take the app and return an async context manager. It is entered when the service has started, so
`app.state.service` works, and left before the service is closed.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from importlib import import_module

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

import lidarcodec
from lidarcodec.transport import Transport
from lidarcodec_server import openapi, problems
from lidarcodec_server.archived.part import archived
from lidarcodec_server.auth import asks, check, known_operator
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.connections import ConnectionMetrics, Connections
from lidarcodec_server.fairness import Fair
from lidarcodec_server.live.part import live
from lidarcodec_server.metrics.gate import GateMetrics
from lidarcodec_server.middleware import BodyLimit, FromHere, Knock, Observe, Reserved
from lidarcodec_server.operations import Audit
from lidarcodec_server.past.part import past
from lidarcodec_server.service import Service

Part = Callable[[FastAPI], AbstractAsyncContextManager[object]]

ROUTERS = (
    "health",
    "streams",
    "settings",
    "audit",
    "codecs",
    "links",
    "metrics",
    "session",
    "fleet",
    "page",
    "sockets",
    "snapshot",
    "recordings",
    "archive",
    "past",
    "maps",
)
PARTS: tuple[Part, ...] = (live, past, archived)


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    service: Service = app.state.service
    async with AsyncExitStack() as stack:
        stack.push_async_callback(run_in_threadpool, service.close)
        try:
            await run_in_threadpool(service.start)
            for part in PARTS:
                await stack.enter_async_context(part(app))
        except Exception as error:
            app.state.failure = error  # for `serve`, which prints it as one line
            raise
        yield


def create_app(config: ServerConfig | None = None, *, transport: Transport | None = None) -> FastAPI:
    """The application; nothing is opened before its lifespan begins.

    transport: an open network session to use instead of an own one; the caller closes it
    """
    config = config or ServerConfig()
    app = FastAPI(
        title="lidarcodec server",
        version=lidarcodec.__version__,
        summary="Streams of a fleet of LiDARs: what they do, and how to change it.",
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        lifespan=_lifespan,
    )
    app.state.config, app.state.failure = config, None
    app.state.service = Service(config, transport)
    connections = Connections(
        config.max_connections, config.max_connections_a_host, config.reserved_connections, config.proxies
    )
    app.state.connections = connections
    app.state.service.metrics.registry.register(ConnectionMetrics(connections))
    app.state.service.metrics.registry.register(GateMetrics(app.state.service.gate))
    problems.install(app)
    app.add_middleware(Audit, enter=app.state.service.enter)
    app.add_middleware(Fair, most=config.max_requests_a_host, wait_s=config.request_s, proxies=config.proxies, who=asks)
    app.add_middleware(BodyLimit, max_bytes=config.max_body_bytes, limit_s=config.body_s)
    app.add_middleware(Knock, check=check)
    app.add_middleware(FromHere, needs_local_host=lambda: config.loopback and not app.state.service.tokens.seen)
    app.add_middleware(Reserved, is_operator=known_operator)
    app.add_middleware(Observe, metrics=app.state.service.metrics)
    for name in ROUTERS:
        # `include_router` would make each route anew for each application, at its first request.
        app.router.routes.extend(import_module(f"lidarcodec_server.routes.{name}").router.routes)
    app.openapi = openapi.document(app)  # type: ignore[method-assign]
    return app
