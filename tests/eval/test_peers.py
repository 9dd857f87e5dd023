"""Adapters beside their peers: taking turns, and the table."""

from peers import (
    Rates,
    Subject,
    comparison,
    take_turns,
)


def test_subjects_take_turns_after_they_have_compiled():
    calls = []
    names = ("a", "b")
    found = [Subject(name, 3, lambda name=name: calls.append(name)) for name in names]
    measured = take_turns(found, rounds=2, seconds=1e-4)
    assert calls[:4] == ["a", "a", "b", "b"]
    turns = [name for i, name in enumerate(calls) if i == 0 or calls[i - 1] != name]
    assert turns == ["a", "b", "a", "b", "a", "b"]
    assert [len(each.rates) for each in measured] == [2, 2]
    assert all(rate > 0 for each in measured for rate in each.rates)


def test_the_table_compares_the_best_and_gives_the_range_of_the_rounds():
    core = Subject("core", 1024, lambda: None)
    other = Subject("torch", 1024, lambda: None, beside="core")
    lines = comparison(
        [Rates(core, (100_000.0, 80_000.0)), Rates(other, (60_000.0, 90_000.0))]
    ).splitlines()
    assert lines[2:] == [
        "| core | 1,024 | 100,000 |  |",
        "| torch | 1,024 | 90,000 | 0.9 (0.6 … 1.12) |",
    ]
