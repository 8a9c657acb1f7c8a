"""The explorer: a graph, models and agents as pages, served or exported as a static site.

Read ``page`` first, then one module of ``pages``, such as ``pages.path``, with its template. A
page consists of settings, a view and a template. The settings are a frozen record whose fields are
the address, so that every choice is a link. The view is a function of the opened folders and the
settings, and returns a record, which ``format=json`` prints. The template shows the view. The
server and the static site render the same pages and differ only in their addresses.

- ``page``: the class ``Page``, addresses, and long lists.
- ``pages``: a module for each kind of page, and ``PAGES``, the registry.
- ``explored``: opened folders, and values that are computed once, by the first page that needs them
  (``Explored.once``): tasks, the planner, a policy bound to tasks.
- ``predictor``: a link predictor's scores, ranks and reasons, for the pages about links.
- ``site``: pages from templates with links between them, and the two ways to publish them, a server
  and a static folder; ``commands``: ``wordcraft-kg explore``.
- ``templates``, ``static``: HTML and the two scripts.

Free to change without asking: templates, texts, drawings, limits of lists. Others rely on the names
of pages and settings (people keep addresses), on the views' JSON, on ``Page`` and ``PageState``
(other distributions add pages by entry points, see ``docs/explorer.md``), and on ``site.json``. Two
rules are about security: every label goes through escaping, since books come from strangers, and a
static site names no folder of the machine that wrote it.
"""
