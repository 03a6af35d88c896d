"""One run under way: how far it is, whose turn it is."""
