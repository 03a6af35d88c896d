"""What is played, and what a learner sees of it."""
