"""The table on a terminal, with lines that other threads print above it."""

from __future__ import annotations

import io
import re
import threading
import time

from rich.table import Table

from gcs_coloc.sinks.terminal import LiveTable, SharedConsole

LINES = 150
ESCAPE = re.compile(r"\x1b\[([\d;?]*)([A-Za-z])|(\r)|(\n)|([^\x1b\r\n]+)")


def on_screen(written: str) -> list[str]:
    """What a terminal shows that is tall enough for all of it; of the control codes, those that move up and that erase a line."""
    rows, row = [""], 0
    for number, code, _, new_line, text in (match.groups() for match in ESCAPE.finditer(written)):
        if code == "A":
            row -= int(number or 1)
        elif code == "K":
            rows[row] = ""
        elif new_line:
            row += 1
            if row == len(rows):
                rows.append("")
        elif text:
            rows[row] = text
    return rows


def of_height(rows: int) -> Table:
    table = Table("vehicle", title="fleet")
    for number in range(rows):
        table.add_row(str(number))
    return table


def test_lines_that_are_printed_while_the_table_grows_and_shrinks_leave_no_piece_of_it_behind():
    written = io.StringIO()
    console = SharedConsole(file=written, force_terminal=True, width=80, height=LINES, color_system=None)
    live = LiveTable(console)
    printing = threading.Thread(target=lambda: [console.print(f"line {number}") for number in range(LINES)])
    printing.start()
    height = 0
    while printing.is_alive():
        height = height % 7 + 1
        live.show(of_height(height))
    live.show(of_height(3))
    live.close()
    deadline = time.monotonic() + 60.0
    while "\x1b[?25h" not in written.getvalue():  # the cursor comes back when the last table is drawn
        assert time.monotonic() < deadline
        threading.Event().wait(0.01)
    shown = [row.strip() for row in on_screen(written.getvalue()) if row.strip()]
    assert [row for row in shown if row.startswith("line")] == [f"line {number}" for number in range(LINES)]
    assert sum(row == "fleet" for row in shown) == 1
