from __future__ import annotations

import pytest

from needleplan.devices import Deadline, VirtualClock, memory_pair
from needleplan.errors import LinkClosed


def test_a_memory_link_delivers_whole_messages_in_order() -> None:
    here, there = memory_pair()
    here.send(b"one")
    here.send(b"two")
    assert [there.receive(0), there.receive(0), there.receive(0)] == [b"one", b"two", b""]


def test_the_other_end_reads_what_was_sent_before_the_link_was_closed() -> None:
    here, there = memory_pair()
    with here:
        here.send(b"last words")
    assert there.receive(1) == b"last words"
    with pytest.raises(LinkClosed, match="other end"):
        there.receive(1)
    with pytest.raises(LinkClosed):
        here.send(b"nothing")


def test_a_deadline_passes_on_its_own_clock() -> None:
    clock = VirtualClock()
    deadline = Deadline(clock, 0.5)
    clock.sleep(0.2)
    assert deadline.left_s == pytest.approx(0.3)
    clock.advance(-1)
    clock.advance(0.3)
    assert deadline.passed
    assert deadline.left_s == 0
