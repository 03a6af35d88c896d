"""Which tests stay together where several processes share them out (``make test``), and which are begun first.

A group is played in order by one process. All that needs a Ray makes three of them: the first is begun first, the
others last, side by side, so that there are two Rays at once only where nothing else computes; two cores do not carry
more. Every other module is a group by itself, so that what it prepares is prepared once; those with the most tests
come first, so that no long one is left for the end.
"""

from __future__ import annotations

import pytest

_FIRST, _KINDS = "ray", ("session", "own", "soak")
_LAST = {"head": "ray, head", "guide": "ray, guide"}


def kind_of(item: pytest.Item) -> str | None:
    """What Ray a test needs: the session's, one of its own, those of the soak or a page, the shared head; or none."""
    fixtures = getattr(item, "fixturenames", ())
    if not item.get_closest_marker("ray"):
        return None
    if item.get_closest_marker("soak"):
        return "soak"
    if "storage_port" in fixtures:
        return "guide"
    return "head" if "head" in fixtures else "session" if "ray_session" in fixtures else "own"


def group_of(item: pytest.Item) -> str:
    """The name of the group to which a test belongs."""
    kind = kind_of(item)
    if kind is None:
        return item.nodeid.partition("::")[0]
    return _LAST.get(kind, _FIRST)


def share_out(items: list[pytest.Item]) -> None:
    """Mark each test with its group, and put the groups in the order in which they are to be begun."""
    groups: dict[str, list[pytest.Item]] = {}
    for item in items:
        groups.setdefault(group_of(item), []).append(item)
    items.clear()
    last = list(_LAST.values())
    for name in sorted(groups, key=lambda name: (name in last, name != _FIRST, -len(groups[name]), name)):
        if name == _FIRST:
            groups[name].sort(key=lambda item: _KINDS.index(kind_of(item) or ""))
        for item in groups[name]:
            item.add_marker(pytest.mark.xdist_group(name))
        items += groups[name]
