"""The crafting worlds as environments: one at a time, in batches, and open-ended."""
