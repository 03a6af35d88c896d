"""From observations to the inputs of networks, space by space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from apel.learners.deep.encoding import Encoder


def encoded(space: spaces.Space[Any], observations: Any, **options: Any) -> list[Any]:
    """Through the type in which they are stored."""
    encoder = Encoder(space, **options)
    found = encoder(np.asarray(observations))
    assert found.dtype == np.float32
    assert found.shape[1:] == encoder.shape
    stored = encoder.stored(np.asarray(observations))
    assert stored.shape == (len(found), 1, encoder.frame_bytes)
    return found.tolist()


def test_boxes_go_in_as_they_are() -> None:
    """Numbers are numbers, of any type."""
    space = spaces.Box(-10.0, 10.0, (2,))
    assert encoded(space, [[1.5, -2.0]]) == [[1.5, -2.0]]
    assert encoded(space, [[1.5, -2.0], [0.25, 3.0]]) == [[1.5, -2.0], [0.25, 3.0]]
    assert encoded(spaces.Box(-9, 9, (2,), dtype=np.int64), [[-7, 8]]) == [[-7.0, 8.0]]
    assert Encoder(space).frame_bytes == 8


def test_a_box_without_dimensions_is_a_vector_of_one_number() -> None:
    """Of each run."""
    space = spaces.Box(-1.0, 1.0, ())
    assert encoded(space, [0.5, -0.25]) == [[0.5], [-0.25]]


def test_images_of_bytes_are_scaled() -> None:
    """0 … 255 become 0 … 1, and are stored as bytes; vectors of bytes are not images."""
    space = spaces.Box(0, 255, (1, 1, 2), dtype=np.uint8)
    assert encoded(space, [[[[0, 255]]], [[[51, 102]]]]) == [
        [[[0.0, 1.0]]],
        [[[pytest.approx(0.2), pytest.approx(0.4)]]],
    ]
    assert Encoder(space).frame_bytes == 2
    vector = spaces.Box(0, 255, (2,), dtype=np.uint8)
    assert encoded(vector, [[0, 255]]) == [[0.0, 255.0]]
    assert Encoder(vector).frame_bytes == 2


def test_images_of_bits_are_not_scaled() -> None:
    """MinAtar's channels are 0 or 1."""
    space = spaces.Box(0, 1, (2, 1, 1), dtype=np.bool_)
    assert encoded(space, [[[[True]], [[False]]]]) == [[[[1.0]], [[0.0]]]]
    assert Encoder(space).frame_bytes == 2


@pytest.mark.parametrize("start", [0, 5, -1, 300, 2**40])
def test_discrete_observations_are_one_hot(start: int) -> None:
    """From the first one of the space on, whatever its number."""
    space = spaces.Discrete(3, start=start)
    assert encoded(space, [start, start + 2]) == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert encoded(space, [start + 1, start]) == [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    assert Encoder(space).shape == (3,)


def test_large_discrete_observations_are_stored_whole() -> None:
    """Beyond a byte, and beyond two."""
    assert encoded(spaces.Discrete(70_000), [69_999])[0].index(1.0) == 69_999
    found = encoded(spaces.Discrete(300), [299])
    assert found[0].index(1.0) == 299


def test_multi_discrete_observations() -> None:
    """Numbers as they are, or one-hot vectors side by side."""
    space = spaces.MultiDiscrete([2, 3])
    assert encoded(space, [[1, 2], [0, 0]]) == [[1.0, 2.0], [0.0, 0.0]]
    assert encoded(space, [[1, 2], [0, 0]], encoding="one_hot") == [[0, 1, 0, 0, 1], [1, 0, 1, 0, 0]]


def test_multi_discrete_observations_may_start_elsewhere() -> None:
    """One-hot vectors count from each variable's first value."""
    space = spaces.MultiDiscrete([2, 3], start=[1, 5])
    assert encoded(space, [[1, 5], [2, 7]], encoding="one_hot") == [[1, 0, 1, 0, 0], [0, 1, 0, 0, 1]]


def test_multi_discrete_observations_may_be_negative() -> None:
    """They are stored with their sign."""
    assert encoded(spaces.MultiDiscrete([3, 3], start=[-1, 0]), [[-1, 2]]) == [[-1.0, 2.0]]


def test_multi_discrete_observations_are_no_images() -> None:
    """Only a Box of bytes is divided by 255."""
    assert encoded(spaces.MultiDiscrete(np.full((1, 1, 2), 5)), [[[[1, 4]]]]) == [[[[1.0, 4.0]]]]


def test_multi_discrete_observations_may_have_rows() -> None:
    """One-hot vectors side by side, in the order of the flattened variables."""
    space = spaces.MultiDiscrete([[2, 2], [2, 3]])
    assert encoded(space, [[[0, 1], [1, 2]]], encoding="one_hot") == [[1, 0, 0, 1, 0, 1, 0, 0, 1]]


def test_multi_binary_observations() -> None:
    """Bits are numbers."""
    assert encoded(spaces.MultiBinary(3), [[0, 1, 1]]) == [[0.0, 1.0, 1.0]]


def test_the_encoding_is_for_multi_discrete_alone() -> None:
    """Boxes stay numbers and Discrete observations one-hot, whatever the option says."""
    assert encoded(spaces.Box(-1.0, 1.0, (2,)), [[0.5, 1.0]], encoding="one_hot") == [[0.5, 1.0]]
    assert encoded(spaces.Discrete(2), [1], encoding="raw") == [[0.0, 1.0]]


def test_other_spaces_are_refused() -> None:
    """The error names the space and those that there are."""
    with pytest.raises(ValueError, match=r"found the observation space Tuple.*expected a Box, Discrete, MultiDiscrete"):
        Encoder(spaces.Tuple([spaces.Discrete(2)]))
