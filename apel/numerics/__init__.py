"""Compiling, random streams and rounding: what all numbers rest on."""
