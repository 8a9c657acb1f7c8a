"""Serving pages on this machine, for all apps with a browser: the listening socket, the guard and the style sheet.

The guard checks hosts, origins, sizes and headers before every page, and shows errors without
internals.
"""
