"""Agents that play the crafting environments, their baselines, and people who play by the same rules."""
