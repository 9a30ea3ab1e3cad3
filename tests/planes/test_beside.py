"""Two things at once: what a user would lose is an error that no one sees, or a thread that is left behind."""

from __future__ import annotations

import threading

import pytest

from lidarcodec.planes.beside import THREAD, beside


def test_the_block_and_the_computation_run_at_the_same_time() -> None:
    met = threading.Barrier(2, timeout=10)
    with beside(met.wait, pays=True) as result:
        met.wait()
        assert result() in (0, 1)


def test_what_does_not_pay_is_computed_by_the_caller() -> None:
    with beside(threading.get_ident, pays=False) as result:
        assert result() == threading.get_ident()


@pytest.mark.parametrize("pays", [False, True])
def test_an_error_of_the_computation_reaches_the_caller(pays: bool) -> None:
    with pytest.raises(ZeroDivisionError), beside(lambda: 1 // 0, pays=pays) as result:
        result()


def test_an_error_in_the_block_leaves_no_thread() -> None:
    go_on = threading.Event()

    def fail() -> None:
        with beside(lambda: go_on.wait(10), pays=True):
            go_on.set()
            raise ValueError("the block")

    with pytest.raises(ValueError, match="the block"):
        fail()
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith(THREAD)]


def test_where_no_thread_can_be_started_the_caller_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with beside(threading.get_ident, pays=True) as result:
        assert result() == threading.get_ident()
