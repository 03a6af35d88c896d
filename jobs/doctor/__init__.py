"""What is fine here, what is not, and what to do: facts are gathered first, then judged by pure functions."""
