"""Whatever stands in an experiment file, it is validated or refused: soon, and without a traceback."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.cases import FOLDER
from tests.fuzz_specs import SECONDS, Verdict, judge, mutated, shipped_texts

LIGHT = [
    name
    for name, text in shipped_texts().items()
    if not any(f"type: {kind}" in text for kind in ("dqn", "acer", "sac"))
]


def assert_good(verdict: Verdict) -> None:
    """No fault, and soon; memory is looked at by ``python -m tests.fuzz_specs``, which is a process of its own."""
    assert verdict.kind in ("valid", "refused"), verdict.story
    assert verdict.seconds < SECONDS
    assert "Traceback" not in verdict.story


@pytest.fixture(scope="module")
def _warm() -> None:
    for name in LIGHT:
        judge(shipped_texts()[name])


@pytest.mark.usefixtures("_warm")
@settings(max_examples=300, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.sampled_from(LIGHT), st.integers(0, 2**32))
def test_mutated_files(name: str, seed: int) -> None:
    """Mutations of the files that come along, but for those with deep learners, which take longer to build."""
    assert_good(judge(mutated(shipped_texts()[name], seed)))


CASES = sorted(
    str(path.relative_to(FOLDER)) for case in ("unchecked", "slow-validate") for path in (FOLDER / case).glob("*.yaml")
)


@pytest.mark.usefixtures("_warm")
@pytest.mark.parametrize("case", CASES)
def test_files_that_went_wrong(case: str) -> None:
    """tests/cases: once a traceback, or many seconds and gigabytes; the first may be spent on importing PyTorch."""
    text = (FOLDER / case).read_text(encoding="utf-8")
    judge(text)
    verdict = judge(text)
    assert_good(verdict)
    assert verdict.kind == "refused"
    assert "mutated.yaml:" in verdict.story
