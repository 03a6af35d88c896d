"""How a shard of runs is played: one host per base learner, one coordinator, in this process or on a Ray cluster."""
