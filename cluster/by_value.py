"""Classes and functions of a user's modules go to other processes with all that they are, not as names to import."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def shipped_by_value(modules: Collection[str]) -> Iterator[None]:
    """Within, what Ray sends of these modules needs no such module there; that of ``__main__`` never does."""
    from ray import cloudpickle as untyped

    cloudpickle: Any = untyped
    registered = [sys.modules[name] for name in modules if name not in cloudpickle.list_registry_pickle_by_value()]
    for module in registered:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in registered:
            cloudpickle.unregister_pickle_by_value(module)
