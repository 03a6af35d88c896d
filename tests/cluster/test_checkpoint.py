"""Checkpoints hold plain data and give back what they were given."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cluster.checkpoint import CheckpointError, pack, seal, unpack, unseal

PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
ARRAYS = hnp.arrays(st.sampled_from([np.float64, np.int64, np.uint64, np.bool_, np.float32]), hnp.array_shapes())
TREES = st.recursive(
    PLAIN | ARRAYS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)


def same(one: Any, other: Any) -> bool:
    """Equal trees, arrays by value and type."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other and type(one) is type(other))


@given(TREES)
def test_round_trip(tree: Any) -> None:
    """What is packed is unpacked, value for value."""
    assert same(tree, unpack(pack(tree)))


def test_big_integers_survive() -> None:
    """The state of a NumPy generator holds integers of 128 bits."""
    state = np.random.default_rng(7).bit_generator.state
    generator = np.random.default_rng(8)
    generator.bit_generator.state = unpack(pack(state))
    assert generator.random() == np.random.default_rng(7).random()


@pytest.mark.parametrize("tree", [{"a": [object()]}, {"a": np.array([object()])}, {1: 2}, {"f": len}])
def test_code_is_refused(tree: Any) -> None:
    """Anything but plain data is refused, with its place."""
    with pytest.raises(CheckpointError, match=r"^state"):
        pack(tree)


@pytest.mark.parametrize("content", [b"", b"no file", pack({"a": np.zeros(3)})[:-40]])
def test_damaged_file(content: bytes) -> None:
    """A damaged file is told from a checkpoint."""
    with pytest.raises(CheckpointError, match="found an unreadable state"):
        unpack(content)


def test_pickles_are_not_loaded(tmp_path: Any) -> None:
    """A file with pickled objects in it is refused rather than run."""
    path = tmp_path / "evil.npz"
    np.savez(path, tree=np.array([{"a": 1}], dtype=object))
    with pytest.raises(CheckpointError):
        unpack(path.read_bytes())


LABEL = {"arm": "APEL", "runs": "0-5"}
SEALED = seal(pack({"a": np.arange(30), "b": ["text", 1.5]}), LABEL)


def test_every_byte_is_covered() -> None:
    """Wherever a bit is flipped, or the file is cut off, that is seen."""
    for place in range(len(SEALED)):
        for bit in (1, 32, 128):
            flipped = bytearray(SEALED)
            flipped[place] ^= bit
            with pytest.raises(CheckpointError):
                unseal(bytes(flipped), LABEL)
        with pytest.raises(CheckpointError):
            unseal(SEALED[:place], LABEL)


def test_seal_keeps_the_format() -> None:
    """A sealed file is still one that NumPy reads."""
    with np.load(io.BytesIO(SEALED)) as arrays:
        assert arrays["a0"].tolist() == list(range(30))


@pytest.mark.parametrize("label", [{}, {"arm": "APEL"}, {**LABEL, "seed": "1"}, {**LABEL, "arm": "SSBAS"}])
def test_seal_of_another(label: dict[str, str]) -> None:
    """What is another one's is refused, with what it is and what it should be."""
    with pytest.raises(CheckpointError, match=r"^found the (arm|runs|seed) .*, expected"):
        unseal(SEALED, label)
