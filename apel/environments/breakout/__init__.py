"""Breakout (§4.2), of which each learner sees its own view: pixels, RAM or symbols, and the handcrafted state.

Nothing is imported here: each game needs packages of its own (`apel.environments.breakout.extras`).
"""
