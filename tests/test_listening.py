"""Who may ask a local page's server, told by what the browser says of the request."""

import pytest

from jshape.app.ports import refused

HERE = "127.0.0.1"


@pytest.mark.parametrize(
    "host, headers",
    [
        (HERE, {"host": "127.0.0.1:8077"}),  # a program
        (HERE, {"host": "localhost:9000", "sec-fetch-site": "none"}),  # typed; through a tunnel
        (HERE, {"host": "127.0.0.1:8077", "sec-fetch-site": "same-origin"}),
        (HERE, {"host": "127.0.0.1:8077", "origin": "http://127.0.0.1:8077"}),
        ("localhost", {"host": "[::1]:8077"}),
        ("0.0.0.0", {"host": "192.0.2.7:8077", "origin": "http://192.0.2.7:8077"}),
        ("Lab.example.org", {"host": "lab.example.org:8077"}),
    ],
)
def test_own_pages_typed_addresses_and_programs_are_let_in(host, headers):
    assert refused(headers, host) is None


@pytest.mark.parametrize(
    "host, headers, why",
    [
        (HERE, {}, "not known as ''"),
        (HERE, {"host": "rebound.example:8077"}, "not known as 'rebound.example:8077'"),
        (HERE, {"host": "192.0.2.7:8077"}, "not known as"),
        (HERE, {"host": "[::1"}, "not known as"),
        ("0.0.0.0", {"host": "rebound.example:8077"}, "not known as"),
        (HERE, {"host": "127.0.0.1:8077", "origin": "http://evil.example"}, "another origin"),
        (HERE, {"host": "127.0.0.1:8077", "origin": "null"}, "another origin"),
        (HERE, {"host": "127.0.0.1:8077", "origin": "http://127.0.0.1:1"}, "another origin"),
        (HERE, {"host": "127.0.0.1:8077", "origin": "http://[::1"}, "another origin"),
        (HERE, {"host": "127.0.0.1:8077", "sec-fetch-site": "cross-site"}, "another page"),
        (HERE, {"host": "127.0.0.1:8077", "sec-fetch-site": "same-site"}, "another page"),
    ],
)
def test_other_pages_and_names_are_refused(host, headers, why):
    assert why in refused(headers, host)
