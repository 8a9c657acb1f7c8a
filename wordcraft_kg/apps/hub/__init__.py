"""Exchange of graph folders, model folders and agents with the Hugging Face hub.

Read ``folders`` first: which files of a folder are shared, their checks, licence and card.
``transfer`` pushes a folder as one commit, and pulls a checked folder, by the hub's own client.

The card's text may change freely. The lists of shared files in ``folders`` are a matter of trust:
no other name is uploaded or downloaded, so a new kind of file needs a review (it must hold no code
and no pickle).
"""
