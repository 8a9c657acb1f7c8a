"""Players that use words: people, programs and language models meet the tasks of the agents, as texts.

A *game* (``games``) is a task at a table of the evaluation, or the open-ended world, by labels. A *conversation*
(``conversation``) is a game as texts that are told and heard, whoever the player is. ``knowledge`` is what a player may
look up. ``evaluation`` plays many games and counts like the evaluation of agents. None of the first three needs torch,
unless what is looked up comes from a trained scorer::

    game = TaskGames(World("kitchen", WordCraftConfig(part="test"))).begin(task=0)
    talk = Conversation(game)
    print(talk.opening)
    print(talk.hear("flour + water"))
"""
