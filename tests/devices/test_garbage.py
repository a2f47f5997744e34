"""A full collection of garbage looks at what is new, and finds it."""

import gc
import weakref

from needleplan.devices import no_long_collections


class Ring:
    """Refers to itself: only a collection frees it."""

    def __init__(self) -> None:
        self.itself = self


def test_a_collection_looks_at_what_is_new_only() -> None:
    old = [Ring() for _ in range(1000)]
    with no_long_collections():
        assert gc.get_freeze_count() > len(old)
        new = weakref.ref(Ring())
        gc.collect()
        assert new() is None
        assert len(gc.get_objects()) < gc.get_freeze_count() / 10
    assert gc.get_freeze_count() == 0
    assert any(each is old[0] for each in gc.get_objects())
