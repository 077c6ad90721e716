"""Who may ask a server of this machine, and how many at a time."""

import http.client
import socket
import threading
from contextlib import contextmanager

import pytest

from deepmf_sumo import local_http
from deepmf_sumo.local_http import LocalHandler, LocalServer


class Handler(LocalHandler):
    within_s = 5.0

    def do_GET(self):  # noqa: N802 - of the base class
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_POST = do_GET  # noqa: N815 - of the base class


@contextmanager
def serving(handler=Handler, most=2):
    server = LocalServer(0, handler, most)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def status(port, method="GET", headers=()):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest(method, "/", skip_host=True)
    for name, value in headers:
        connection.putheader(name, value.replace("PORT", str(port)))
    connection.endheaders()
    answer = connection.getresponse().status
    connection.close()
    return answer


HERE = ("Host", "localhost:PORT")


@pytest.mark.parametrize("method", ["GET", "POST"])
@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ([HERE], 200),
        ([("Host", "127.0.0.1:PORT")], 200),
        ([("Host", "[::1]:PORT")], 200),
        ([("Host", "LOCALHOST:PORT"), ("Origin", "http://localhost:PORT")], 200),
        ([HERE, ("Sec-Fetch-Site", "same-origin")], 200),
        ([HERE, ("Sec-Fetch-Site", "none")], 200),
        ([], 403),
        ([("Host", "localhost")], 403),
        ([("Host", "localhost:1")], 403),
        ([("Host", "evil.example:PORT")], 403),
        ([("Host", "localhost.evil.example:PORT")], 403),
        ([HERE, ("Host", "evil.example:PORT")], 403),
        ([HERE, ("Origin", "http://evil.example")], 403),
        ([HERE, ("Origin", "https://localhost:PORT")], 403),
        ([HERE, ("Origin", "http://localhost:1")], 403),
        ([HERE, ("Origin", "null")], 403),
        ([HERE, ("Origin", "")], 403),
        ([HERE, ("Origin", "http://localhost:PORT"), ("Origin", "http://evil.example")], 403),
        ([HERE, ("Sec-Fetch-Site", "cross-site")], 403),
        ([HERE, ("Sec-Fetch-Site", "same-site")], 403),
    ],
)
def test_only_this_machine_and_its_own_page_is_answered(method, headers, expected):
    with serving() as port:
        assert status(port, method, headers) == expected


def test_more_connections_than_places_are_closed_and_a_place_comes_back():
    with serving() as port:
        idle = [socket.create_connection(("127.0.0.1", port), timeout=5) for _ in range(2)]
        for _ in range(20):  # a descriptor each, if they were kept
            with socket.create_connection(("127.0.0.1", port), timeout=5) as over:
                assert over.recv(1) == b""
        assert threading.active_count() < 10
        for one in idle:
            one.close()
        for _ in range(100):  # until the threads have seen it
            try:
                assert status(port, headers=[HERE]) == 200
                break
            except (ConnectionError, http.client.BadStatusLine):
                continue
        else:
            raise AssertionError("no place came back")


def test_a_request_that_never_ends_is_dropped(capfd):
    class Short(Handler):
        within_s = 0.05

    with serving(Short) as port, socket.create_connection(("127.0.0.1", port), timeout=5) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert slow.recv(1) == b""
    assert capfd.readouterr().err == ""


def test_dripping_bytes_do_not_lengthen_the_time(monkeypatch):
    times = iter([0.0, 1.0, 4.0, 6.0])
    monkeypatch.setattr(local_http.time, "monotonic", lambda: next(times))
    left, right = socket.socketpair()
    with left, right:
        left.sendall(b"abc")
        limited = local_http._Limited(right, 5.0)
        assert [limited.read(1), limited.read(1)] == [b"a", b"b"]
        with pytest.raises(TimeoutError):
            limited.read(1)


def test_a_client_that_leaves_is_no_traceback(capfd):
    class Leaves(Handler):
        def do_GET(self):  # noqa: N802 - of the base class
            raise BrokenPipeError

    with serving(Leaves) as port, pytest.raises(http.client.RemoteDisconnected):
        status(port, headers=[HERE])
    assert capfd.readouterr().err == ""
