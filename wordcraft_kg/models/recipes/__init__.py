"""Recipe scorers: estimate how plausible a result is for a pair, fitted on held-out recipes."""
