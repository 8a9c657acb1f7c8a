"""Other programs as players: any program by a line protocol, MCP clients, and language models in Inspect AI.

Each is a thin layer over :mod:`wordcraft_kg.agents.words`, which says what is played and what is understood.
"""
