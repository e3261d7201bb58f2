"""
Access to the server: no other origin, and other machines only with a token.

An ASGI middleware for all requests and the web socket: a foreign page that is open in the same
browser can neither drive the robot nor see it.
"""
from collections.abc import Mapping
import re
import secrets
import socket
from urllib.parse import quote

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

LOOPBACK = ('127.0.0.1', 'localhost', '::1')
LOOPBACK_HOST = re.compile(r'(127\.0\.0\.1|localhost|\[::1\])(:\d+)?')
ALL_ADDRESSES = ('', '0.0.0.0', '::')  # to bind to; a browser needs a name
COOKIE = 'diffdrive_token'

# Of every response: no other page may embed this one, against clickjacking.
HEADERS = [('content-security-policy', "frame-ancestors 'none'"), ('x-frame-options', 'DENY')]


class AccessControl:
    """Responds 403 or passes on; token is None if only this machine can reach the server."""

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a permitted request."""
        has_origin = scope['type'] in ('http', 'websocket')
        app = self._response(HTTPConnection(scope)) if has_origin else self._app
        await app(scope, receive, send)

    def _response(self, request: HTTPConnection) -> ASGIApp:
        """Return what responds to a request: the application, or this control in its place."""
        is_socket = request.scope['type'] == 'websocket'
        reason = refusal(
            request.headers, is_socket=is_socket, needs_loopback=self._token is None)
        if not reason:
            if self._token is None or self._has_cookie(request.headers.get('cookie', '')):
                return self._app
            if not is_socket and self._is_token(request.query_params.get('token', '')):
                # From the address to a cookie, so that no history or screenshot has it.
                response = RedirectResponse('/', 303, {'referrer-policy': 'no-referrer'})
                response.set_cookie(COOKIE, self._token, httponly=True, samesite='strict')
                return response
            reason = 'open the address that was printed at start'
        # Servers respond 403 to a socket that is closed before it is accepted.
        return WebSocketClose(1008, reason) if is_socket else PlainTextResponse(
            f'refused: {reason}\n', 403)

    def _has_cookie(self, cookies: str) -> bool:
        # The parser of the standard library ends at the first invalid cookie, and that of
        # starlette keeps one of each name, though each path may have one.
        pairs = (each.strip().partition('=') for each in cookies.split(';'))
        return any(name == COOKIE and self._is_token(value) for name, _, value in pairs)

    def _is_token(self, given: str) -> bool:
        return self._token is not None and secrets.compare_digest(
            given.encode(), self._token.encode())


def refusal(headers: Mapping[str, str], *, is_socket: bool, needs_loopback: bool) -> str:
    """Return why a request is refused, or '' if its origin is the page itself."""
    host, origin = headers.get('host', ''), headers.get('origin')
    # DNS rebinding: a foreign name that resolves to this machine is refused by its Host.
    if needs_loopback and not LOOPBACK_HOST.fullmatch(host):
        return f'host {host!r} is not this machine'
    if origin is None:
        if is_socket:
            return 'a socket needs an origin'
        return 'another page embeds this one' if _is_embedded(headers) else ''
    return '' if origin in (f'http://{host}', f'https://{host}') else (
        f'origin {origin!r} is not this page')


def address(host: str, port: int, token: str | None) -> str:
    """Return the address to open in a browser."""
    if host in ALL_ADDRESSES:
        host = socket.gethostname()
    name = f'[{host}]' if ':' in host else host
    return f'http://{name}:{port}/' + (f'?token={quote(token)}' if token else '')


def _is_embedded(headers: Mapping[str, str]) -> bool:
    """Return whether a page of another origin embeds this one, and does not link to it."""
    navigation = headers.get('sec-fetch-mode'), headers.get('sec-fetch-dest')
    return headers.get('sec-fetch-site') in ('cross-site', 'same-site') and (
        navigation != ('navigate', 'document'))
