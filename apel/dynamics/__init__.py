"""What an environment may offer beyond Gymnasium's interface."""
