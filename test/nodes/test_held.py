"""What is held of descriptions: a bounded number, and those in use."""

from __future__ import annotations

from sal_height.nodes.held import Held


def test_the_oldest_goes_if_none_is_in_use() -> None:
    held = Held[int](3)
    assert [held.put(name, number) for number, name in enumerate("abcde")] == [None, None, None, "a", "b"]
    assert list(held) == ["c", "d", "e"]
    assert held.use("a") is None


def test_what_is_in_use_stays_however_many_others_come() -> None:
    held = Held[int](3)
    held.put("used", 1)
    assert held.use("used") == 1
    for number in range(100):
        held.put(str(number), number)
        assert len(held) <= 3
    assert held.use("used") == 1
    assert set(held) == {"98", "99", "used"}


def test_of_those_in_use_the_one_goes_whose_last_use_is_longest_ago() -> None:
    held = Held[str](3)
    for name in "abc":
        held.put(name, name)
        held.use(name)
    held.use("a")
    assert held.put("d", "d") == "b"
    assert list(held) == ["d", "c", "a"]
    assert held.put("e", "e") == "d"  # never used


def test_a_new_value_of_a_name_takes_the_place_of_the_old_one() -> None:
    held = Held[int](2)
    held.put("a", 1)
    held.use("a")
    assert held.put("a", 2) is None
    assert held.put("b", 3) is None
    assert held.put("b", 4) is None
    assert (held.use("a"), held.use("b")) == (2, 4)
