"""Text agents: people, programs and language models that play the tasks of the agents as texts.

A *game* (``games``) is a task at a table of the evaluation, or the open-ended world, by labels. A *conversation*
(``conversation``) is a game as prompts and answers, whoever plays. ``knowledge`` can be looked up; ``results`` counts
as the evaluation of agents does. Players come by the line protocol (``line_player``), the Model Context Protocol
(``mcp_server``) or Inspect AI (``inspect_tasks``)::

    game = TaskGames(World("kitchen", WordCraftConfig(part="test"))).begin(task=0)
    talk = Conversation(game)
    print(talk.opening)
    print(talk.hear("flour + water"))
"""
