"""HTML pages, charts and tables from the evaluation results in :mod:`wordcraft_kg.evaluation`.

Read :mod:`~wordcraft_kg.reports.pages` first: it renders templates and writes report folders.
Reports evaluate nothing. A function takes a view and returns a :class:`~pages.Report` or a page:

- ``link_report``, ``agent_report``: a file for each page, with its template
  of the same name in ``templates/``. The explorer shares the charts of agents.
- ``charts``: figures of Matplotlib from plain numbers, shown as SVG.
- ``glossary.toml``: explained terms.

A page is a single file that can be read without a script. Headings and explained terms are
collected while the page template is rendered, and become the contents table and the glossary. A
script sorts, searches and copies tables; the page's content security policy admits only this
script, by hash, and all resources are in the file.

Texts, charts and templates may change at will. The view is public: a template may show its fields
in another way, and the fields themselves belong to :mod:`wordcraft_kg.evaluation`.
"""
