"""Planning: search for the most probable way to the goal with learned recipes.

Read ``search`` first, for pairs; ``source`` gives its plans to agents and players as the source p.
"""
