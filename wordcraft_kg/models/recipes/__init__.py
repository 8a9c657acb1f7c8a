"""Recipe scorers: models that estimate how plausible a result is for two ingredients, fitted on held-out recipes."""
