"""HTML pages, charts and tables from the values of :mod:`wordcraft_kg.evaluation`.

A page is one file that needs no script to be read. Headings and explained terms are collected while its template is
rendered; they become the table of contents and the glossary. One script sorts, searches and copies tables; the content
security policy of the page admits it by its hash and nothing else, and nothing is loaded from elsewhere.
"""
