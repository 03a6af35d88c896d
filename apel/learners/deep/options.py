"""The kinds of numbers that options of deep learners are."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from apel.numerics.whole_numbers import whole

_LARGEST = 10**9
"""Of what is counted or remembered: beyond, sizes in bytes would overflow."""
Count = Annotated[int, Field(ge=0, le=_LARGEST, strict=True), BeforeValidator(whole)]
Width = Annotated[int, Field(ge=1, le=_LARGEST, strict=True), BeforeValidator(whole)]
Memory = Annotated[int, Field(ge=1, le=10_000_000, strict=True), BeforeValidator(whole)]
"""Transitions or segments: more take up gigabytes for every run."""
NonNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
