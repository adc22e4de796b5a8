"""A worker that dies while it answers has no metrics this time, and the others have theirs."""

from __future__ import annotations

import socket
import threading

import pytest

from gcs_coloc.service.supervisor import _scrape


@pytest.mark.parametrize("answer", [b"HTTP/1.1 200 OK\r\nContent-Length: 500\r\n\r\n# HELP", b"HTTP/1.1 2", b""])
def test_an_answer_that_breaks_off_is_none(answer):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer_and_die():
            connection, _ = server.accept()
            with connection:
                connection.recv(1024)
                connection.sendall(answer)

        worker = threading.Thread(target=answer_and_die)
        worker.start()
        assert _scrape(f"http://127.0.0.1:{server.getsockname()[1]}/") == []
        worker.join()
