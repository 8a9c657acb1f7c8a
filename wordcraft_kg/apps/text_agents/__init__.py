"""Text agents: people, programs and language models that play the agents' tasks as texts.

Read ``conversation`` first: it turns a *game* into prompts, and answers into attempts. A game
(``games``) is a crafting task with a fixed inventory, or a game in the open-ended world (without a
goal: discover entities). None of the files for playing needs torch, unless look-ups come from a
trained scorer::

    talk = TaskGames(World.open("kitchen", WordCraftConfig(part="test"))).begin(task=0)
    print(talk.opening)
    print(talk.hear("flour + water"))

What lies where:

* rules: ``settings`` (options), ``games``, ``conversation`` (with facts to look up, and the seat
  of doors with a reset), ``plays`` (games by settings, by name and number, and by difficulty);
* doors for players: ``text_players`` (programs, and models behind an address), ``mcp_server`` (MCP
  clients), ``inspect_tasks`` (language models in Inspect AI, and their logs);
* doors for training: ``trl`` (an environment and a data set), ``openenv_server``, ``text_env``
  (Gymnasium), ``chats`` (to fine-tune on);
* results: ``results`` (``games.jsonl``: record, play, resume; the same metrics as agent
  evaluation);
* the benchmark: ``benchmark`` (tracks), ``benchmark_players`` (kinds of players), ``submission``
  (write and verify);
* ``browser_game``: a recipe book as a page that plays alone;
* ``commands``: the commands, by entry points in ``pyproject.toml``; ``play`` is a person's door.

Change freely: kinds of players, wording of errors, tables, commands. A changed prompt makes another
experiment: its hash is in every result and submission, and the manifest has the standard ones.
Change only with a new version: ``data/`` and the fields of ``Submission`` and ``GameLine``, because
published submissions are compared byte by byte.
"""
