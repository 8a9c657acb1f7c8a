"""Text agents: people, programs and language models that play the agents' tasks as texts.

A *game* (``games``) is a task at an evaluation table, or the open-ended world, by labels. A *conversation*
(``conversation``) plays a game by prompts and answers. ``knowledge`` can be looked up, ``results`` counts as agent
evaluation does. Players connect by the line protocol (``line_player``), MCP (``mcp_server``) or Inspect AI
(``inspect_tasks``)::

    talk = Conversation(TaskGames(World("kitchen", WordCraftConfig(part="test"))).begin(task=0))
    print(talk.opening)
    print(talk.hear("flour + water"))
"""
