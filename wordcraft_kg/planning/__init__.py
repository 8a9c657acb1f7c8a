"""Planning: search for the most probable way to the goal with learned recipes."""
