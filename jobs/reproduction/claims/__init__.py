"""The ledger of claims: what the dissertation says, and what is measured."""
