"""Experiments without a file: of classes and functions that a script or a notebook holds."""
