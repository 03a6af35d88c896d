"""The command line, ``apel``."""
