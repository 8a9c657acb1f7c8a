"""Recipe scorers: how plausible is a result of two ingredients? Fitted on held-out recipes."""
