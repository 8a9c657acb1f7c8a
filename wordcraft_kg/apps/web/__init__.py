"""Serving pages on this machine, for all apps with a browser.

Read ``guard`` first: it checks hosts, origins, sizes and headers before every page, and shows
errors without internals. ``serving`` opens the listening socket and runs the server, gives clients
deadlines and bounds their number. ``guard`` also has the style sheet and static files.

The style sheet and texts of errors may change freely. Every check in ``guard`` and every deadline
in ``serving`` closes a known way to attack a server on the reader's own machine: add checks,
but remove none without a review.
"""
