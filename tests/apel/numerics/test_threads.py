"""One thread unless somebody says otherwise."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import SimpleNamespace

import pytest

from apel.learners.deep.devices import open_device
from apel.numerics import threads

CORES = max(threads._untouched())
OTHER = CORES + 1
"""More than this machine has cores, so that nobody takes it for what was there at first."""


class Torch(SimpleNamespace):
    """Its two functions that matter here."""

    count: int

    def get_num_threads(self) -> int:
        return self.count

    def set_num_threads(self, count: int) -> None:
        self.count = count


@pytest.fixture
def torch(monkeypatch: pytest.MonkeyPatch) -> Torch:
    """PyTorch as it begins, in a process in which nothing was settled or said."""
    fake = Torch(count=CORES)
    monkeypatch.setitem(sys.modules, "torch", fake)  # type: ignore[arg-type]
    monkeypatch.setattr(threads, "_is_settled", False)
    for name in threads.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    return fake


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({}, 1),
        ({"OMP_NUM_THREADS": "3"}, 3),
        ({"OMP_NUM_THREADS": "4,2", "MKL_NUM_THREADS": "2"}, 4),
        ({"MKL_NUM_THREADS": "2"}, 2),
        ({"OMP_NUM_THREADS": "many"}, 1),
    ],
)
def test_one_thread_unless_variables_say_otherwise(
    environ: Mapping[str, str], expected: int, torch: Torch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a variable came too late for the library, as Ray's may; OpenMP's may be a list."""
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    threads.settle()
    assert torch.count == expected


def test_what_a_program_has_set_stays(torch: Torch) -> None:
    """A number that PyTorch does not begin with is somebody's, and so is one that was set later."""
    torch.set_num_threads(OTHER)
    threads.settle()
    assert torch.count == OTHER
    torch.set_num_threads(CORES)
    threads.settle()
    assert torch.count == CORES


def test_nothing_is_loaded_for_it(torch: Torch, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tabular learner needs no PyTorch; it is settled when there is one."""
    monkeypatch.delitem(sys.modules, "torch")
    threads.settle()
    assert "torch" not in sys.modules
    monkeypatch.setitem(sys.modules, "torch", torch)  # type: ignore[arg-type]
    threads.settle()
    assert torch.count == 1


def test_making_a_deep_learner_settles_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever computes with PyTorch asks for its device first."""
    settled: list[bool] = []
    monkeypatch.setattr(threads, "settle", lambda: settled.append(True))
    open_device("cpu")
    assert settled == [True]
