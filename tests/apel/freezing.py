"""Selectors that want policies frozen within epochs of 2^β episodes, as ESBAS does (Algorithm 6)."""

from __future__ import annotations

from typing import ClassVar

from apel.selectors import Apel, Fixed, Uniform


class FreezingFixed(Fixed):
    """Always one learner."""

    freezes_policies: ClassVar[bool] = True


class FreezingUniform(Uniform):
    """Any learner."""

    freezes_policies: ClassVar[bool] = True


class FreezingApel(Apel):
    """The better learner."""

    freezes_policies: ClassVar[bool] = True
