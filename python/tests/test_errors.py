"""Errors, Ctrl-C and threads."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

import wcal
from conftest import FIXTURES, draw

COLUMNS = {"stimulus": "load", "response": "signal"}


def error(call, *args, **options):
    with pytest.raises(wcal.WcalError) as caught:
        call(*args, **options)
    said = str(caught.value)
    assert said and "\n" not in said and "/tmp" not in said and not said.startswith("error")
    return said


def test_errors_are_one_line_that_says_what_and_where():
    table = draw(0.0)
    text = table.astype({"signal": object})
    text.loc[2, "signal"] = "1.2.3"
    missing = error(wcal.verify, table, stimulus="load", response="nowhere")
    assert "data.csv" in missing and "nowhere" in missing
    cell = error(wcal.verify, text, **COLUMNS)
    assert "data.csv" in cell and "line 4" in cell and "1.2.3" in cell
    assert "cubic" in error(wcal.verify, table, **COLUMNS, model="cubic")
    assert "--sugar" in error(wcal.verify, table, **COLUMNS, sugar=2)
    assert "no-such-folder" in error(wcal.predict, "no-such-folder/calibration.json", table)
    assert "expected" in error(wcal.verify, 3, **COLUMNS)
    assert "one length" in error(wcal.verify, {"load": [1], "signal": [1, 2]}, **COLUMNS)
    assert "row 1" in error(wcal.verify, [[1, 2], [1]], **COLUMNS, columns=["load", "signal"])
    assert "name" in error(wcal.verify, table, **COLUMNS, name="a/b")
    # Negative control: the same table without a fault.
    assert wcal.verify(table, **COLUMNS).verdict == "adequate"


def threads():
    """Threads of wcal in this process: those of its pool, which stay, and one for each call."""
    names = (task / "comm" for task in Path("/proc/self/task").iterdir())
    return sum(name.read_text().strip() == "wcal" for name in names)


def when(condition, then=lambda: None):
    """Does it as soon as the condition holds, a minute at most; whether it came to hold."""
    for _ in range(6000):
        if condition():
            then()
            return True
        time.sleep(0.01)
    return False


def test_ctrl_c_returns_and_the_computation_ends():
    # The pool is there after a first call.
    wcal.verify(FIXTURES / "nist/pontius")
    pool = threads()

    def watched(then):
        """Does it while a call computes."""
        thread = threading.Thread(target=when, args=(lambda: threads() > pool, then))
        thread.start()
        return thread

    watch = watched(lambda: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        wcal.verify(FIXTURES / "whiskerfbg")
    watch.join()
    assert when(lambda: threads() == pool)
    # Negative control: without a signal a call comes to its end. That a thread of Python saw it
    # compute says that the GIL was released: with it held the thread sees the pool alone.
    seen = []
    watch = watched(lambda: seen.append(threads()))
    assert wcal.verify(FIXTURES / "nist/pontius").verdict == "effect"
    watch.join()
    assert seen and seen[0] > pool


def test_two_threads_verify_at_once_and_keep_their_own_answers():
    found = {}

    def work(quadratic):
        found[quadratic] = wcal.verify(draw(quadratic), **COLUMNS, name=f"cell-{quadratic}")

    threads = [threading.Thread(target=work, args=(q,)) for q in (0.0, 1e-6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {q: (r.verdict, r.document["session"]) for q, r in found.items()} == {
        0.0: ("adequate", "cell-0.0"),
        1e-6: ("effect", "cell-1e-06"),
    }


def test_nothing_is_printed(capfd):
    wcal.verify(FIXTURES / "nist/pontius")
    assert capfd.readouterr() == ("", "")
    # Negative control: what is printed is seen.
    os.write(2, b"x")
    assert capfd.readouterr().err == "x"
