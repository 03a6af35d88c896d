"""Experiments as jobs of a Ray cluster: what is sent, the client of its dashboard, and the commands."""
