"""Studies: comparisons between agents, described in TOML files, with their trainings and results.

Read ``study`` first: it says what a study is. Then follow a study through the room:

| file | content |
|---|---|
| ``study``, ``builtin/`` | the TOML file: variants, grid, seeds, claims; the package's studies |
| ``plan`` | tasks that make graphs, scorers and runs; equal tasks are planned once |
| ``engine``, ``perform`` | missing tasks by joblib or Ray, inputs first; a worker's part |
| ``results`` | the results folder, and the record with all results |
| ``view``, ``claims`` | means, intervals, comparisons and verdicts |
| ``report`` | the same as tables, pictures and page |

A task's folder name (its address) is a hash over non-default settings and input addresses, so
studies share finished tasks. ``figures.json``, with a task's results, is written last and marks the
task as done. All tables, pictures, claims and pages derive from one record, ``StudyResults``.

Studies in ``builtin/``, wording, tables and pictures may be changed freely. A change of ``plan``
that changes an address discards finished trainings, and a change of training code that changes
results needs a new number in ``VERSIONS``, see there. The rules of ``claims`` and the fields of
records in JSON are contracts: readers have results that rest on them.
"""
