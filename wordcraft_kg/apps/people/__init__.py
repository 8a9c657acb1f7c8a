"""People at the task: studies with the paper's protocol in the browser.

Read ``protocol`` first: the tasks, their order, and what an answer is. Then read ``study`` (the
study folder: ``study.json``, forms and conditions) and ``answers_database`` (each answer is on disk
before the next page). ``web_app`` has the pages, ``summary`` the success rates of people, and of
agents at the same tables, ``study_config`` the settings and the default consent text. ``commands``
has the command line.

Pages and summaries may change freely. Three things may not: the seeds in ``protocol``
(a begun study must pose the same tasks), the tables in ``answers_database`` and the fields of
``study.json`` (answers of people cannot be collected again), and the stored data in general. The
consent text promises that no name, address, cookie or date is stored: ask for a review of the text
before anything else is recorded. Changed templates give a study another ``texts_hash``, so studies
that have begun must be finished with the earlier version.
"""
