"""Gradients clipped and parameters stepped run by run, as each run alone would be."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from apel.learners.deep.networks import NetworkOptions, q_network
from apel.learners.deep.parameters import Layout
from apel.learners.deep.stacked_rows import RowAdam, Rows, clip_each_row, clip_each_variable
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.steps import runs_of

CPU = torch.device("cpu")
LAYOUT = Layout(q_network((1,), 2, NetworkOptions(hidden=())))


def gradient(*numbers: float) -> Tensor:
    """Of one row with two variables of two elements each."""
    row = torch.zeros(1, LAYOUT.size)
    weight, bias = LAYOUT.unpack(row)
    weight[0], bias[0] = torch.tensor([numbers[:2]]), torch.tensor(numbers[2:])
    return row[0]


def test_each_variable_is_clipped_by_itself() -> None:
    """TensorFlow's clip_by_norm: g · c / max(‖g‖, c) for each variable of each run.

    (3, 4) has the norm 5: at c = 1 it becomes (0.6, 0.8); (0.3, 0.4) stays, so does what is zero.
    """
    rows = torch.stack([gradient(3.0, 4.0, 0.3, 0.4), gradient(0.0, 0.0, -6.0, 8.0)])
    found = clip_each_variable(rows, LAYOUT, 1.0)
    expected = torch.stack([gradient(0.6, 0.8, 0.3, 0.4), gradient(0.0, 0.0, -0.6, 0.8)])
    torch.testing.assert_close(found, expected)
    assert found is rows


def test_each_row_is_clipped_by_itself() -> None:
    """All variables of a run together: (2, 1, 2, 4) has the norm 5 and becomes a fifth, (0.3, 0, 0.4, 0) stays."""
    rows = torch.stack([gradient(2.0, 1.0, 2.0, 4.0), gradient(0.3, 0.0, 0.4, 0.0)])
    found = clip_each_row(rows, 1.0)
    torch.testing.assert_close(found, torch.stack([gradient(0.4, 0.2, 0.4, 0.8), gradient(0.3, 0.0, 0.4, 0.0)]))
    assert found is rows


def plain_adam(row: Tensor, learning_rate: float, epsilon: float) -> tuple[torch.nn.Parameter, torch.optim.Adam]:
    parameter = torch.nn.Parameter(row.clone())
    return parameter, torch.optim.Adam([parameter], lr=learning_rate, eps=epsilon)


SCHEDULE = [[0, 1, 2], [1], [1, 2], [0], [0, 2], [2], [0, 1, 2], [1]]


def gradient_at(step: int, run: int) -> Tensor:
    return torch.randn(32, generator=torch.Generator().manual_seed(10 * step + run)) * 10.0 ** (run - 1)


def test_every_row_has_an_adam_of_its_own() -> None:
    """Runs that step at different times have different clocks and moments; those left out stay as they are."""
    rows = torch.randn(3, 32, generator=torch.Generator().manual_seed(1))
    plain = [plain_adam(row, 0.01, 1e-4) for row in rows]
    adam = RowAdam(rows, 0.01, 1e-4)
    for step, chosen in enumerate(SCHEDULE):
        before = rows.clone()
        adam.step(runs_of(*chosen), torch.stack([gradient_at(step, run) for run in chosen]))
        for run in range(3):
            if run in chosen:
                parameter, optimiser = plain[run]
                parameter.grad = gradient_at(step, run)
                optimiser.step()
                torch.testing.assert_close(rows[run], parameter.detach(), rtol=1e-6, atol=1e-7)
            else:
                assert torch.equal(rows[run], before[run])


def test_adam_by_hand() -> None:
    """The first step is lr · g / (|g| + ε), whatever g's size: the corrected moments are g and g²."""
    rows = torch.zeros(1, 16)
    gradients = torch.zeros(1, 16)
    gradients[0, :3] = torch.tensor([4.0, -0.001, 1e-4])
    RowAdam(rows, 0.5, 1e-4).step(runs_of(0), gradients)
    # −0.5 · 0.001 / 0.0011 and −0.5 · 1e-4 / 2e-4.
    assert rows[0, :4].tolist() == pytest.approx([-0.4999875, 0.4545454, -0.25, 0.0], rel=1e-5)


def test_restored_adam_goes_on_identically() -> None:
    """Clocks and moments go through a file, those of runs that never stepped included, bit for bit."""
    for stop in range(len(SCHEDULE)):
        rows = torch.randn(4, 32, generator=torch.Generator().manual_seed(1))
        adam = RowAdam(rows, 0.01, 1e-8)
        for step, chosen in enumerate(SCHEDULE[:stop]):
            adam.step(runs_of(*chosen), torch.stack([gradient_at(step, run) for run in chosen]))
        others = rows.clone()
        other = RowAdam(others, 0.01, 1e-8)
        other.step(runs_of(0, 3), torch.ones(2, 32))
        others.copy_(rows)
        other.restore(unpack(pack(adam.state())))
        for step, chosen in enumerate(SCHEDULE[stop:], start=stop):
            gradients = torch.stack([gradient_at(step, run) for run in chosen])
            adam.step(runs_of(*chosen), gradients.clone())
            other.step(runs_of(*chosen), gradients.clone())
        assert torch.equal(rows, others)
        for name, values in adam.state().items():
            np.testing.assert_array_equal(values, other.state()[name])


def test_rows_are_read_and_written_by_run() -> None:
    """Chosen rows come in the order of the runs; those that are not named stay."""
    rows = Rows(3, CPU, 3)
    matrix = torch.arange(6.0).reshape(3, 2)
    assert rows.of(matrix, runs_of(0, 2)).tolist() == [[0.0, 1.0], [4.0, 5.0], [0.0, 1.0]]
    assert rows.of(matrix, runs_of(0, 1, 2)).tolist() == matrix.tolist()
    rows.write(matrix, runs_of(1), torch.tensor([[7.0, 7.0], [9.0, 9.0]]))
    assert matrix.tolist() == [[0.0, 1.0], [7.0, 7.0], [4.0, 5.0]]
    rows.copy(matrix, -matrix, runs_of(0, 2))
    assert matrix.tolist() == [[0.0, -1.0], [7.0, 7.0], [-4.0, -5.0]]
    assert [one.tolist() for one in rows.calls(runs_of(0, 2))] == [[0, 2]]
    assert rows.calls(runs_of()) == []


@pytest.mark.parametrize("lanes", [1, 2, 3, 5, 8])
def test_lanes_are_filled_up(lanes: int) -> None:
    """Calls of one shape: more runs than lanes come in several calls, fewer are filled up with the first."""
    rows = Rows(5, CPU, lanes)
    matrix = torch.arange(5.0)[:, None]
    runs = runs_of(0, 1, 3, 4)
    calls = rows.calls(runs)
    assert np.concatenate(calls).tolist() == [0, 1, 3, 4]
    for one_call in calls:
        chosen = rows.of(matrix, one_call)[:, 0].tolist()
        expected = one_call.tolist() + [float(one_call[0])] * (lanes - len(one_call))
        assert chosen == expected
        assert rows.tensor(one_call).tolist() == expected
