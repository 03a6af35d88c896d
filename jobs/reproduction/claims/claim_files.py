"""Claims from the files beside the experiments, in the order of the ledger."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from typing import Any

from pydantic import ValidationError

from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment, shipped_texts
from jobs.experiment.yaml_source import Source, SpecError, parse
from jobs.reproduction.claims.claim import Claim


def shipped_claims() -> list[Claim]:
    """The claims of the dissertation, and those that are held beside them, in the order of ``ledger.yaml``.

    Raises
    ------
    SpecError
        If a file is not valid, or a claim is not in the ledger exactly once.
    """
    claims: dict[str, Claim] = {}
    for name, text in shipped_texts("claims.yaml").items():
        for claim in read_claims(text, f"{name}/claims.yaml", name):
            if claim.id in claims:
                message = f"{name}/claims.yaml: id: found {claim.id!r} beside {claims[claim.id].experiment}, too"
                raise SpecError(message)
            claims[claim.id] = claim
    ledger = parse((resources.files("jobs") / "experiments" / "ledger.yaml").read_text("utf-8"), "ledger.yaml")
    order = [claim_id for ids in ledger.content.values() for claim_id in ids]
    if sorted(order) != sorted(claims):
        differing = sorted({*order} ^ {*claims}) or sorted(name for name in {*order} if order.count(name) > 1)
        message = f"ledger.yaml: found otherwise than in the files of claims: {', '.join(differing)}"
        raise SpecError(message)
    return [claims[claim_id] for claim_id in order]


def judged_experiments(claims: Iterable[Claim]) -> dict[str, Experiment]:
    """The shipped experiments that claims are about, by name."""
    return {name: load_experiment(name) for name in dict.fromkeys(claim.experiment for claim in claims)}


def read_claims(text: str, name: str, experiment: str) -> list[Claim]:
    """The claims on an experiment from YAML, ``claims:`` and a list.

    Raises
    ------
    SpecError
        If they are not valid; the message names the line.
    """
    source = parse(text, name)
    listed = source.content.get("claims")
    if not isinstance(listed, list):
        message = f"{name}: found no list of claims, expected one below 'claims'"
        raise SpecError(message)
    claims = [_read_claim(source, place, content, experiment) for place, content in enumerate(listed)]
    for place, claim in enumerate(claims):
        if claim.id in (other.id for other in claims[:place]):
            message = f"{source.where(('claims', place))}: id: found {claim.id!r} twice, expected once"
            raise SpecError(message)
    return claims


def _read_claim(source: Source, place: int, content: Any, experiment: str) -> Claim:
    if isinstance(content, dict):
        if "experiment" in content:
            where = source.where(("claims", place, "experiment"))
            message = f"{where}: experiment: found it in a claim, expected none: it is the one beside the file"
            raise SpecError(message)
        content = {**content, "experiment": experiment}
    try:
        return Claim.model_validate(content)
    except ValidationError as error:
        lines = []
        for one in error.errors():
            where = source.where(("claims", place, *one["loc"]))
            field = ".".join(map(str, one["loc"]))
            lines.append(f"{where}: {field}: {one['msg'].removeprefix('Value error, ')}")
        raise SpecError("\n".join(lines)) from error
