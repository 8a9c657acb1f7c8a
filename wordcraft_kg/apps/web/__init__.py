"""Serving pages on this machine, for all apps with a browser: the listening socket, the guard and the style sheet.

The guard stands before every page: it checks hosts, origins, sizes and headers, and shows errors without internals.
"""
