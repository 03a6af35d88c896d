"""Claims for the ledger."""

from __future__ import annotations

from typing import Any

from jobs.reproduction.claims.claim import Claim

DIFFERENCE = {"of": "difference", "metric": "train_time", "arms": ["APEL", "SSBAS"]}


def claim(**fields: Any) -> Claim:
    """A claim about the distractor mazes, but for the fields that are given."""
    content = {
        "id": "one",
        "source": "Fig. 4.7",
        "text": "APEL is faster | than SSBAS.",
        "expected": "open",
        "experiment": "distractor-maze",
        "statistic": DIFFERENCE,
        "direction": "below",
        "threshold": 0,
    }
    return Claim.model_validate(content | fields)
