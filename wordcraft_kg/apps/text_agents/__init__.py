"""Text agents: people, programs and language models that play the agents' tasks by reading and writing text.

A *game* (``games``) is a crafting task with a fixed table of entities, or a game in the open-ended world (without a
goal: discover entities). A *conversation* (``conversation``) turns a game into prompts and answers. Players may look up
facts (``knowledge``); ``results`` computes the same metrics as agent evaluation. Players connect by the line protocol
(``line_player``), MCP (``mcp_server``) or Inspect AI (``inspect_tasks``).
"""
