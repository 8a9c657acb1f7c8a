"""Recipe-level knowledge: how plausible it is that a pair makes a result, learned on recipes held out of themselves."""
