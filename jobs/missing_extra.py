"""What is said where the extra ``service`` is missing: the core of this program installs without it.

This module imports nothing but what Python brings along.
"""

from __future__ import annotations

SERVICE = frozenset({
    "PIL", "cloudpickle", "grpc", "matplotlib", "packaging", "pandas", "pyarrow", "ray", "requests", "rich", "typer",
    "yaml",
})  # fmt: skip
"""The modules that the extra ``service`` installs."""


def missing_service(error: ModuleNotFoundError) -> str:
    """What to do about a module that was not found; empty where it is none of the extra's.

    >>> missing_service(ModuleNotFoundError("No module named 'ray'", name="ray"))
    "found no ray, expected the extra 'service' to be installed: pip install 'apel[service]'"
    """
    module = (error.name or "").partition(".")[0]
    if module not in SERVICE:
        return ""
    return f"found no {module}, expected the extra 'service' to be installed: pip install 'apel[service]'"
