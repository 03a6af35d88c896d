"""The hosts are asked for: they take minutes, and two cores for themselves."""

from __future__ import annotations

import pytest

from tests.hosts.machine import why_not


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what needs hosts unless ``-m hosts`` asks for it, and where there can be none."""
    needing = [item for item in items if item.get_closest_marker("hosts")]
    if not needing:
        return
    reason = why_not() if "hosts" in config.getoption("markexpr") else "asked for by `pytest -m hosts`"
    if reason:
        for item in needing:
            item.add_marker(pytest.mark.skip(reason=reason))
