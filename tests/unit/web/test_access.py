"""Who is let in: by the name the server is called, by the page the request comes from, by the token."""

import asyncio
from datetime import UTC
from email.utils import parsedate_to_datetime

import pytest
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

from gcs_coloc.core.errors import ConfigError
from gcs_coloc.web.access import Guard, bears_token
from gcs_coloc.web.server import read_token


def status(host: str, origin: str | None = None, allowed=()) -> tuple[int, dict[str, str]]:
    headers = [(b"host", host.encode())] + ([(b"origin", origin.encode())] if origin is not None else [])
    scope = {"type": "http", "method": "GET", "path": "/", "headers": headers}
    messages = []

    async def send(message):
        messages.append(message)

    asyncio.run(Guard(PlainTextResponse("in"), allowed)(scope, None, send))
    return messages[0]["status"], {k.decode(): v.decode() for k, v in messages[0]["headers"]}


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [
        ("127.0.0.1:8080", None, 200),
        ("localhost:8080", "http://localhost:8080", 200),
        ("[::1]:8080", "http://[::1]:8080", 200),
        ("192.168.1.5:8080", "http://192.168.1.5:8080", 200),
        ("ground.example", "https://ground.example", 200),
        ("GROUND.example:443", None, 200),
        ("127.0.0.1:8080", "http://evil.example", 403),
        ("127.0.0.1:8080", "http://127.0.0.1:9090", 403),
        ("127.0.0.1:8080", "null", 403),
        ("evil.example:8080", None, 403),
        ("127.0.0.1.evil.example", None, 403),
        ("[::1", None, 403),
        ("", None, 403),
    ],
)
def test_foreign_names_and_foreign_pages_stay_outside(host, origin, expected):
    code, headers = status(host, origin, allowed=["Ground.example"])
    assert code == expected
    policy = headers["content-security-policy"]
    assert "unsafe" not in policy
    assert "default-src 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["connection"] == "close"
    assert parsedate_to_datetime(headers["date"]).tzinfo is UTC


@pytest.mark.parametrize(
    ("given", "token", "expected"),
    [
        ("Bearer abcdefghijklmnop", "abcdefghijklmnop", True),
        ("bearer abcdefghijklmnop", "abcdefghijklmnop", True),
        ("Bearer abcdefghijklmno", "abcdefghijklmnop", False),
        ("Bearer ", "abcdefghijklmnop", False),
        ("abcdefghijklmnop", "abcdefghijklmnop", False),
        ("Basic abcdefghijklmnop", "abcdefghijklmnop", False),
        ("Bearer None", None, False),
        ("Bearer ", None, False),
    ],
)
def test_only_the_operators_token_counts_and_without_one_nothing_does(given, token, expected):
    assert bears_token(Headers({"authorization": given}), token) is expected


@pytest.mark.parametrize("content", [b"", b"short\n", b"with a space in the middle", "äöüäöüäöüäöüäöüäöü".encode(), None])
def test_a_token_file_that_protects_nothing_is_refused(tmp_path, content):
    file = tmp_path / "token"
    if content is not None:
        file.write_bytes(content)
        file.chmod(0o600)
    with pytest.raises(ConfigError, match="token"):
        read_token(file)


def test_a_good_token_is_read_without_its_line_end(tmp_path):
    (tmp_path / "token").write_bytes(b"0123456789abcdef\r\n")
    (tmp_path / "token").chmod(0o644)
    with pytest.raises(ConfigError, match=r"web\.token_file: .*can be used by others \(mode 0644\); run: chmod 600 "):
        read_token(tmp_path / "token")
    (tmp_path / "token").chmod(0o600)
    assert read_token(tmp_path / "token") == "0123456789abcdef"
