"""
Access to the server: no other origin, and other machines only with a token.

An ASGI middleware for all requests and the web socket: a foreign page that is open in the same
browser can neither drive the robot nor see it.
"""
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
import secrets
import socket
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK = ('127.0.0.1', 'localhost', '::1')
ALL_ADDRESSES = ('', '0.0.0.0', '::')  # to bind to; a browser needs a name
COOKIE = 'diffdrive_token'


class AccessControl:
    """Responds 403 or passes on; token is None if only this machine can reach the server."""

    def __init__(self, app: App, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a permitted request."""
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        headers = {key.decode('latin-1'): value.decode('latin-1')
                   for key, value in scope['headers']}
        reason = refusal(
            headers, is_socket=scope['type'] == 'websocket', needs_loopback=self._token is None)
        if reason:
            await refuse(scope, receive, send, reason)
        elif self._token is None or self._has_cookie(headers.get('cookie', '')):
            await self._app(scope, receive, _without_frames(send))
        elif scope['type'] == 'http' and self._has_token(scope):
            await self._set_cookie(send)
        else:
            await refuse(scope, receive, send, 'open the address that was printed at start')

    def _has_cookie(self, cookies: str) -> bool:
        # The parser of the standard library ends at the first invalid cookie.
        pairs = (each.strip().partition('=') for each in cookies.split(';'))
        return any(name == COOKIE and self._is_token(value) for name, _, value in pairs)

    def _has_token(self, scope: Scope) -> bool:
        given = parse_qs(scope['query_string'].decode('latin-1')).get('token', [''])[0]
        return self._is_token(given)

    def _is_token(self, given: str) -> bool:
        return self._token is not None and secrets.compare_digest(
            given.encode(), self._token.encode())

    async def _set_cookie(self, send: Send) -> None:
        """Move the token from the address to a cookie, so that no history or screenshot has it."""
        cookie = f'{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/'
        await send({'type': 'http.response.start', 'status': 303, 'headers': [
            (b'location', b'/'), (b'set-cookie', cookie.encode()),
            (b'referrer-policy', b'no-referrer')]})
        await send({'type': 'http.response.body', 'body': b''})


def refusal(headers: MutableMapping[str, str], *, is_socket: bool, needs_loopback: bool) -> str:
    """Return why a request is refused, or '' if its origin is the page itself."""
    host, origin = headers.get('host', ''), headers.get('origin')
    # DNS rebinding: a foreign name that resolves to this machine is refused by its Host.
    if needs_loopback and _name_of(f'//{host}') not in LOOPBACK:
        return f'host {host!r} is not this machine'
    if origin is None:
        if is_socket:
            return 'a socket needs an origin'
        return 'another page embeds this one' if _is_embedded(headers) else ''
    if _is_web(origin) and urlsplit(origin).netloc == host:
        return ''
    return f'origin {origin!r} is not this page'


def address(host: str, port: int, token: str | None) -> str:
    """Return the address to open in a browser."""
    if host in ALL_ADDRESSES:
        host = socket.gethostname()
    name = f'[{host}]' if ':' in host else host
    return f'http://{name}:{port}/' + (f'?token={quote(token)}' if token else '')


def _is_embedded(headers: MutableMapping[str, str]) -> bool:
    """Return whether a page of another origin embeds this one, and does not link to it."""
    navigation = headers.get('sec-fetch-mode'), headers.get('sec-fetch-dest')
    return headers.get('sec-fetch-site') in ('cross-site', 'same-site') and (
        navigation != ('navigate', 'document'))


def _name_of(address: str) -> str | None:
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def _is_web(origin: str) -> bool:
    return _name_of(origin) is not None and urlsplit(origin).scheme in ('http', 'https')


async def refuse(scope: Scope, receive: Receive, send: Send, reason: str) -> None:
    """Respond 403; a socket is closed before it is accepted, which servers turn into 403."""
    if scope['type'] == 'websocket':
        await receive()
        await send({'type': 'websocket.close', 'code': 1008, 'reason': reason})
        return
    await send({'type': 'http.response.start', 'status': 403, 'headers': [
        (b'content-type', b'text/plain; charset=utf-8')]})
    await send({'type': 'http.response.body', 'body': f'refused: {reason}\n'.encode()})


def _without_frames(send: Send) -> Send:
    """Forbid other pages to embed this one, against clickjacking."""
    extra: Iterable[tuple[bytes, bytes]] = (
        (b'content-security-policy', b"frame-ancestors 'none'"), (b'x-frame-options', b'DENY'))

    async def send_with_headers(message: Any) -> None:
        if message['type'] == 'http.response.start':
            message = {**message, 'headers': [*message.get('headers', []), *extra]}
        await send(message)

    return send_with_headers
