"""Tests that need a Ray are three groups, one begun first and two last, each with one Ray after the other."""

from __future__ import annotations

import pytest

from tests.scheduling import kind_of, share_out


class Item:
    """As much of a test as its group follows from."""

    def __init__(self, nodeid: str, markers: tuple[str, ...] = (), fixtures: tuple[str, ...] = ()) -> None:
        self.nodeid, self.fixturenames = nodeid, fixtures
        self.markers = list(markers)

    def get_closest_marker(self, name: str) -> str | None:
        return name if name in self.markers else None

    def add_marker(self, marker: pytest.MarkDecorator) -> None:
        self.markers.append(f"group {marker.args[0]}")


def items() -> list[Item]:
    """Tests of three modules that need a Ray, of each kind, and tests beside them that need none."""
    return [
        Item("tests/cluster/test_b.py::test_soak", ("soak", "ray")),
        Item("tests/cluster/test_b.py::test_unit"),
        Item("tests/jobs/test_a.py::test_one"),
        Item("tests/jobs/test_a.py::test_actors", ("ray",), ("ray_session", "small")),
        Item("tests/jobs/test_a.py::test_two"),
        Item("tests/jobs/test_c.py::test_submit", ("ray",), ("head",)),
        Item("tests/jobs/test_c.py::test_interrupted", ("ray",), ("small",)),
        Item("tests/test_guide.py::test_page[4]", ("ray",), ("storage_port",)),
        Item("tests/test_guide.py::test_links"),
    ]


def test_order() -> None:
    """What needs a Ray comes first, kind by kind, then the largest modules, last the guide and what needs the head."""
    shared = items()
    share_out(shared)  # type: ignore[arg-type]
    assert [(item.nodeid.partition("::")[2], item.markers[-1].removeprefix("group ")) for item in shared] == [
        ("test_actors", "ray"),
        ("test_interrupted", "ray"),
        ("test_soak", "ray"),
        ("test_one", "tests/jobs/test_a.py"),
        ("test_two", "tests/jobs/test_a.py"),
        ("test_unit", "tests/cluster/test_b.py"),
        ("test_links", "tests/test_guide.py"),
        ("test_page[4]", "ray, guide"),
        ("test_submit", "ray, head"),
    ]


def test_nothing_is_lost_and_order_within_a_group_stays() -> None:
    """Each test is there once; the tests of a group come in the order of their module."""
    shared = items()
    share_out(shared)  # type: ignore[arg-type]
    assert sorted(item.nodeid for item in shared) == sorted(item.nodeid for item in items())
    assert [item.nodeid[-3:] for item in shared if item.markers == ["group tests/jobs/test_a.py"]] == ["one", "two"]


def test_every_test_that_uses_a_ray_says_so(request: pytest.FixtureRequest) -> None:
    """Otherwise each process would start a Ray, or a cluster, of its own."""
    for item in request.session.items:
        if {"head", "ray_session"} & set(getattr(item, "fixturenames", ())):
            assert kind_of(item) in ("head", "session"), item.nodeid
