"""An experiment: its file, its checks, its plan."""
