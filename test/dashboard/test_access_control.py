"""Only the page itself passes, and from other machines only with the token."""
import asyncio
import socket

from diffdrive_ros.dashboard.access_control import AccessControl, address, COOKIE
import pytest

HOST = ('host', '127.0.0.1:8080')
OURS = ('origin', 'http://127.0.0.1:8080')
TOKEN = 'a-token'


def request(*headers, token=None, kind='http', query=''):
    """Return status (200: passed on) and headers of the response to a request."""
    sent = []

    async def app(scope, receive, send):
        await send({'type': 'http.response.start', 'status': 200, 'headers': []})

    async def receive():
        return {'type': 'websocket.connect'}

    async def send(message):
        sent.append(message)

    scope = {'type': kind, 'query_string': query.encode(), 'path': '/', 'headers': [
        (name.encode(), value.encode()) for name, value in headers]}
    asyncio.run(AccessControl(app, token)(scope, receive, send))
    if sent[0]['type'] == 'websocket.close':
        return 403, {}
    return sent[0]['status'], {
        name.decode(): value.decode() for name, value in sent[0]['headers']}


@pytest.mark.parametrize('kind', ['http', 'websocket'])
def test_page_itself_is_accepted(kind):
    assert request(HOST, OURS, kind=kind)[0] == 200


@pytest.mark.parametrize('kind', ['http', 'websocket'])
@pytest.mark.parametrize('origin', [
    'http://evil.example', 'http://127.0.0.1:9090', 'http://localhost:8080', 'null', '',
    'file://', 'http://127.0.0.1:8080.evil.example', 'http://[', 'ftp://127.0.0.1:8080'])
@pytest.mark.parametrize('token', [None, TOKEN])
def test_other_origin_is_refused(kind, origin, token):
    cookie = ('cookie', f'{COOKIE}={TOKEN}')
    assert request(HOST, ('origin', origin), cookie, kind=kind, token=token)[0] == 403


def test_socket_without_an_origin_is_refused():
    assert request(HOST, kind='websocket')[0] == 403


@pytest.mark.parametrize('host', ['evil.example:8080', '', '[', '192.0.2.1:8080'])
def test_foreign_host_name_is_refused(host):
    assert request(('host', host), ('origin', f'http://{host}'), kind='websocket')[0] == 403
    assert request(('host', host))[0] == 403


@pytest.mark.parametrize('host', ['localhost:1', '127.0.0.1', '[::1]:8080'])
def test_every_name_of_this_machine_is_accepted(host):
    assert request(('host', host), ('origin', f'http://{host}'), kind='websocket')[0] == 200


def test_requests_without_the_token_are_refused():
    assert request(HOST, token=TOKEN)[0] == 403
    assert request(HOST, OURS, token=TOKEN, kind='websocket')[0] == 403
    assert request(HOST, token=TOKEN, query='token=another')[0] == 403
    assert request(HOST, ('cookie', f'{COOKIE}=another'), token=TOKEN)[0] == 403


def test_token_becomes_a_cookie_that_is_accepted():
    status, headers = request(HOST, token=TOKEN, query=f'token={TOKEN}')
    assert (status, headers['location']) == (303, '/')
    assert 'HttpOnly' in headers['set-cookie']
    assert 'SameSite=strict' in headers['set-cookie']
    cookie = ('cookie', headers['set-cookie'].partition(';')[0])
    assert request(HOST, cookie, token=TOKEN)[0] == 200
    assert request(HOST, OURS, cookie, token=TOKEN, kind='websocket')[0] == 200


@pytest.mark.parametrize('other', [
    'theme={"dark": true, "size": [1, 2]}', 'a b=c', '=', 'unquoted="', f'{COOKIE}=another'])
def test_cookie_of_another_server_does_not_hide_the_token(other):
    """Browsers send the cookies of every server on the machine, whatever its port."""
    for cookies in (f'{other}; {COOKIE}={TOKEN}', f'{COOKIE}={TOKEN}; {other}'):
        assert request(HOST, ('cookie', cookies), token=TOKEN)[0] == 200
    assert request(HOST, ('cookie', other), token=TOKEN)[0] == 403


def test_cookie_whose_name_ends_alike_is_refused():
    assert request(HOST, ('cookie', f'x{COOKIE}={TOKEN}'), token=TOKEN)[0] == 403


@pytest.mark.parametrize('site', ['cross-site', 'same-site'])
@pytest.mark.parametrize(('mode', 'kind', 'status'), [
    ('no-cors', 'image', 403), ('no-cors', 'script', 403), ('navigate', 'iframe', 403),
    ('navigate', 'document', 200)])
def test_other_pages_may_link_but_not_embed(site, mode, kind, status):
    assert request(
        HOST, ('sec-fetch-site', site), ('sec-fetch-mode', mode),
        ('sec-fetch-dest', kind))[0] == status


@pytest.mark.parametrize('site', ['none', 'same-origin'])
def test_page_may_request_its_own_files(site):
    assert request(HOST, ('sec-fetch-site', site), ('sec-fetch-mode', 'no-cors'))[0] == 200


def test_token_in_the_address_of_a_socket_is_refused():
    assert request(HOST, OURS, token=TOKEN, kind='websocket', query=f'token={TOKEN}')[0] == 403


@pytest.mark.parametrize(('host', 'name'), [
    ('0.0.0.0', socket.gethostname()), ('::', socket.gethostname()), ('192.0.2.1', '192.0.2.1'),
    ('fd00::1', '[fd00::1]')])
def test_printed_address_can_be_opened(host, name):
    assert address(host, 8080, 'a b') == f'http://{name}:8080/?token=a%20b'
