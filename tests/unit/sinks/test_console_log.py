"""A log that nobody reads holds nothing up and loses its newest lines only; each line says whose it is."""

import logging
import re
import subprocess
import sys
import threading
import time

import pytest

from gcs_coloc.sinks.console import LogWriter


class Slow(logging.Handler):
    """Writes nothing until it is let go."""

    def __init__(self):
        super().__init__()
        self.begun, self.go, self.eleventh = threading.Event(), threading.Event(), threading.Event()
        self.lines = []

    def emit(self, record):
        self.begun.set()
        self.go.wait()
        self.lines.append(record.getMessage())
        if len(self.lines) == 11:
            self.eleventh.set()


@pytest.fixture
def slow():
    handler = Slow()
    yield handler
    handler.go.set()


def logged(writer, texts):
    log = logging.Logger("test")
    log.addHandler(writer)
    for text in texts:
        log.info("line %s", text)


def test_what_is_logged_while_nobody_reads_does_not_wait(slow):
    writer = LogWriter(slow, most=10)
    logged(writer, ["first"])
    assert slow.begun.wait(20)
    logged(writer, range(1000))
    assert writer.lost == 990
    assert slow.lines == []
    slow.go.set()
    assert slow.eleventh.wait(20)
    writer.close()
    assert slow.lines == ["line first", *(f"line {number}" for number in range(10))]


def test_the_last_lines_are_written_at_the_end(slow):
    slow.go.set()
    writer = LogWriter(slow)
    logged(writer, range(500))
    writer.close()
    assert slow.lines == [f"line {number}" for number in range(500)]
    assert writer.lost == 0


def test_a_line_has_its_own_handlers_form_and_no_other(slow):
    slow.go.set()
    writer = LogWriter(slow)
    root = logging.Logger("test")
    root.addHandler(writer)
    assert writer.formatter is not None  # else logging.basicConfig gives it one
    root.warning("refused %d", 3)
    writer.close()
    assert slow.lines == ["refused 3"]


def test_the_end_does_not_wait_for_a_reader_that_never_reads(slow):
    writer = LogWriter(slow, most=3)
    logged(writer, range(100))
    began_s = time.monotonic()
    writer.close()
    assert time.monotonic() - began_s < 20.0
    assert slow.lines == []


FAULTS = """
import logging, threading, warnings
from gcs_coloc.sinks.console import log_to_stderr, log_uncaught
log_to_stderr("INFO", None, "north: ")
log_uncaught()
warnings.warn("of Python")
fault = threading.Thread(target=lambda: {}["of a thread"])
fault.start()
fault.join()
try:
    {}["caught"]
except KeyError:
    logging.getLogger("gcs_coloc").exception("two\\nlines")
{}["at the end"]
"""


def test_every_line_of_a_warning_and_of_a_traceback_names_its_fleet():
    done = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    named = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} (WARNING|ERROR|CRITICAL) north: ")
    assert [line for line in lines if not named.match(line)] == []
    for words in ("of Python", "KeyError: 'of a thread'", "KeyError: 'caught'", "lines", "KeyError: 'at the end'"):
        assert any(line.endswith(words) for line in lines), words
