"""The results of an experiment: where they lie, who writes them, what stands in them."""
