"""Experiments as jobs of a Ray cluster: what is sent, the client of its dashboard, and the commands."""

DEFAULT_ADDRESS = "http://127.0.0.1:8265"
"""Of a dashboard on this machine, or of a tunnel to one."""
