"""Small inputs that went wrong once, each with the right value in ``expected.txt``."""

from pathlib import Path

FOLDER = Path(__file__).parent
